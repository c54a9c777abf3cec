"""Kill each process in turn during an upload, then run the same command again: nothing is lost, blocked or left over.

A failure names its seed; KLEINKRAM_KILLS_SEED repeats it.
"""

import itertools
import os
import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.contract.uploads import MIN_PART_BYTES
from tests.acceptance.conftest import wait_until
from tests.system import backend
from tests.system.chaos.kill_rounds import (
    CONNECTIONS,
    MB,
    VICTIMS,
    Round,
    fill,
    say,
    turns,
    upload_under_fire,
)
from tests.system.cluster import Cluster

# The rounds of CI kill each process once. They have what a full one has: large files of several parts, and more small
# ones than are announced at once. What more bytes add is time.
_FULL_MB, _SMALL_MB = 300, 50
_FULL_RATE_MB_S, _SMALL_RATE_MB_S = 75, 25
_ROUNDS_IN_CI, _ROUNDS_PER_CLUSTER = 4, 10
_UNFINISHED = "SELECT path, state, failure FROM upload WHERE state IN ('open', 'completing')"
_FILES = """
    SELECT file.path, encode(blob.sha256, 'hex') FROM file JOIN blob ON blob.id = file.blob_id
    JOIN mission ON mission.id = mission_id WHERE mission.name = %s AND blob.state = 'verified'
"""
# A job that failed three times waits for 64 s, and one of a killed worker begins anew after as long.
_VERIFIED_AFTER_S = 300.0
_UNVERIFIED = "SELECT count(*) FROM blob WHERE state <> 'verified'"
_LASTING = """
import time
from kleinkram.action import out
for step in range(20):
    print("step", step, flush=True)
    time.sleep(0.1)
(out / "steps").write_text("20")
"""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_upload_survives_kills_of_every_process(cluster: Cluster) -> None:
    rounds = [*_planned(cluster.home, _first_seed(), _ROUNDS_IN_CI, _SMALL_MB)]
    assert _first_seed() != 1 or {victim for one in rounds for victim in one.victims} == {*VICTIMS}
    _rounds(cluster, rounds)


@pytest.mark.soak
def test_a_large_upload_survives_many_rounds_of_kills(tmp_path: Path) -> None:
    first, count = _first_seed(), int(os.environ.get("KLEINKRAM_SOAK_ROUNDS", "100"))
    planned = [*_planned(tmp_path, first, count, _FULL_MB)]
    # A new cluster after some rounds, because a hundred rounds would fill the disk.
    for begin in range(0, count, _ROUNDS_PER_CLUSTER):
        home = tmp_path / f"cluster{begin}"
        home.mkdir()
        cluster = Cluster(home)
        try:
            _rounds(cluster, planned[begin : begin + _ROUNDS_PER_CLUSTER])
        finally:
            cluster.end()
        shutil.rmtree(home)


def _first_seed() -> int:
    return int(os.environ.get("KLEINKRAM_KILLS_SEED", "1"))


def _planned(home: Path, first: int, count: int, size_mb: int) -> Iterator[Round]:
    """Yield the rounds of these seeds. A round depends on its seed only."""
    for seed, victims in enumerate(itertools.islice(turns(random.Random(0)), first, first + count), start=first):
        yield Round(seed, victims, home / f"m{seed}", size_mb * MB)


def _rounds(cluster: Cluster, rounds: list[Round]) -> None:
    # A client whose announcement was lost waits until its lease expires. A short lease tests the same in less time.
    cluster.settings["KLEINKRAM_UPLOAD_LEASE_S"] = "5"
    cluster.settings["DOCKER_HOST"] = f"unix://{cluster.home}/nothing"  # without an engine, runs are processes
    cluster.start()
    cluster.terminal.run("project", "create", "p")
    (cluster.home / "lasting.py").write_text(_LASTING)
    (cluster.home / "notes.txt").write_text("notes of a drive")
    cluster.terminal.run("upload", "-p", "p", "-m", "drive", "--create", cluster.home / "notes.txt")
    for one in rounds:
        say(f"\nround {one.seed}: {', '.join(one.victims)}, {one.size_bytes // MB} MB")
        chance = random.Random(one.seed)
        fill(one, chance)
        if "runner" in one.victims and "supervisor" not in one.victims:
            one.runs = [_launch(cluster) for _ in "ab"]
        upload_under_fire(cluster, one, chance, rate_mb_s=_rate(one))
        assert one.sent_again_bytes <= CONNECTIONS * MIN_PART_BYTES, "more than a part a connection was sent again"
        shutil.rmtree(one.folder)
    _check_state(cluster, rounds)


def _rate(one: Round) -> int:
    return _FULL_RATE_MB_S if one.size_bytes == _FULL_MB * MB else _SMALL_RATE_MB_S


def _launch(cluster: Cluster) -> str:
    script = cluster.home / "lasting.py"
    launched = cluster.terminal.run("action", "run", script, "-p", "p", "-m", "drive", "--force", "--json").json()
    return str(launched["items"][0]["run"]["id"])


def _check_state(cluster: Cluster, rounds: list[Round]) -> None:
    wait_until(lambda: all(cluster.runtime_info()["services"].values()), "every part to run")
    wait_until(lambda: all(_is_over(cluster, run) for one in rounds for run in one.runs), "the runs to end")
    backend.tidy(cluster)
    assert backend.sql(cluster, _UNFINISHED) == [], "no name is blocked"
    wait_until(
        lambda: backend.sql(cluster, _UNVERIFIED) == [(0,)],
        "the server to have read all bytes",
        timeout_s=_VERIFIED_AFTER_S,
    )
    for one in rounds:
        assert dict(backend.sql(cluster, _FILES, one.mission)) == one.sha256, f"round {one.seed}"
    for run in (run for one in rounds for run in one.runs):
        run_info = cluster.terminal.run("run", "info", run, "--json").json()
        assert (run_info["state"], run_info["artifact_count"]) == ("done", 1), run_info
    backend.tidy(cluster)
    sizes_by_key = dict(backend.sql(cluster, "SELECT key, size_bytes FROM blob"))
    assert backend.objects(cluster) == sizes_by_key, "unreferenced or missing objects"
    assert backend.list_multiparts(cluster) == []


def _is_over(cluster: Cluster, run: str) -> bool:
    return backend.sql(cluster, "SELECT ended_at IS NOT NULL FROM run WHERE id = %s", run) == [(True,)]
