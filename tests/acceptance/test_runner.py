"""The runner that `klein up` has of its own: it is there, is killed, and its runs do not notice."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.acceptance.conftest import Instance, Terminal

LASTING = """
import time
from kleinkram.action import out, progress
for step in range(40):
    print("step", step, flush=True)
    progress(step / 40)
    time.sleep(0.1)
(out / "steps").write_text("40")
"""


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, "it did not come true in time"
        time.sleep(0.1)


@pytest.mark.slow
def test_the_runner_of_klein_up_is_killed_and_its_run_goes_on(
    instance: Instance, terminal: Terminal, project: str, tmp_path: Path
) -> None:
    assert (instance.data_dir / "runner-token").stat().st_mode & 0o777 == 0o600
    script = tmp_path / "lasting.py"
    script.write_text(LASTING)
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "notes.txt").write_text("notes of a drive")
    terminal.run("upload", "-p", project, "-m", "drive", "--create", tmp_path / "drive")
    run_id = terminal.run("action", "run", script, "-p", project, "-m", "drive", "--json").json()["items"][0]["run"][
        "id"
    ]
    until(lambda: "step 3" in terminal.run("run", "logs", run_id).out)
    killed = instance.told()["parts"]["runner"]
    os.kill(killed, signal.SIGKILL)
    until(lambda: instance.told()["parts"]["runner"] not in {None, killed})
    until(lambda: terminal.run("run", "info", run_id, "--json").json()["ended_at"])
    said = terminal.run("run", "info", run_id, "--json").json()
    assert (said["state"], said["attempt"], said["artifact_count"]) == ("done", 1, 1)
    assert terminal.run("run", "logs", run_id).out.split("\n")[:40] == [f"step {step}" for step in range(40)]
    runners = terminal.run("runner", "list", "--json").json()["items"]
    (runner,) = [each for each in runners if each["name"] == "klein-up"]
    assert runner["is_alive"]
