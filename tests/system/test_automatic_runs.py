"""Actions that a project names start once on each mission, while the server's processes are killed."""

import random
import time
import uuid

import pytest

from tests.acceptance.conftest import wait_until
from tests.system import backend
from tests.system.cluster import Cluster

_SCRIPT = """
from kleinkram.action import inputs, report
report.check("file.size", "ok" if all(path.stat().st_size for path in inputs()) else "error", "sizes were compared")
"""
# Jobs that a worker left begin again after 20 to 40 s, which pass while others are killed.
_VICTIMS = ("worker", "supervisor", "postgres", "runner", "api")
_MISSIONS = len(_VICTIMS)
_RUNS = """
    SELECT mission.name, count(*), bool_and(run.state = 'done') FROM run JOIN mission ON mission.id = run.mission_id
    GROUP BY mission.name ORDER BY mission.name
"""
_STARTED = "SELECT count(*), count(run_id), count(DISTINCT run_id) FROM automatic_run"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_each_mission_is_run_once_through_kills_of_every_process(cluster: Cluster) -> None:
    cluster.settings["DOCKER_HOST"] = f"unix://{cluster.home}/nothing"  # without an engine, runs are processes
    cluster.start()
    chance, klein = random.Random(24), cluster.terminal
    (cluster.home / "verify.py").write_text(_SCRIPT)
    klein.run("project", "create", "p")
    klein.run("action", "create", cluster.home / "verify.py", "-p", "p")
    klein.run("project", "actions", "add", "verify", "-p", "p", "--on", "complete")
    for number in range(_MISSIONS):
        notes = cluster.home / "drives" / f"drive-{number}" / "notes.txt"
        notes.parent.mkdir(parents=True)
        notes.write_text(f"notes of drive {number}: {uuid.UUID(int=chance.getrandbits(128))}")
    klein.run("upload", "-p", "p", "--mission-per-folder", "--create", "--wait", cluster.home / "drives")
    for number, victim in enumerate(_VICTIMS):
        complete = ("mission", "complete", f"drive-{number}", "-p", "p")
        wait_until(lambda: klein.run(*complete, code=None).code == 0, "the server to answer")  # noqa: B023  at once
        # While the job starts the run, the run is claimed, or its results are stored.
        kill_at = time.monotonic() + chance.uniform(0, 0.4)
        wait_until(lambda: time.monotonic() >= kill_at, "the moment to kill")  # noqa: B023  called at once
        cluster.kill(victim)
        cluster.start_again_if_dead()
        wait_until(lambda: all(cluster.runtime_info()["services"].values()), "every process to run")
    wait_until(lambda: klein.run("project", "info", "p", code=None).code == 0, "the server to answer")
    backend.tidy(cluster)
    expected = [(f"drive-{number}", 1, True) for number in range(_MISSIONS)]
    wait_until(lambda: backend.sql(cluster, _RUNS) == expected, "one run of each mission to be done")
    backend.tidy(cluster)
    assert backend.sql(cluster, _RUNS) == expected
    assert backend.sql(cluster, _STARTED) == [(_MISSIONS, _MISSIONS, _MISSIONS)]
