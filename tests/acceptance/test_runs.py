"""Runs on a real `klein up`: launch, follow, download, take over, cancel, lineage."""

import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.conftest import Instance, Terminal, end, running_instance, wait_until

pytestmark = pytest.mark.slow

WHOLE = """\
# /// script
# [tool.kleinkram]
# name = "look"
# right = "CREATE"
# inputs = {paths = ["*.bag"]}
# parameters = [{name = "wait", type = "boolean", default = false}]
# ///
import time
from kleinkram.action import inputs, out, parameters, progress, report

progress(0.1, "looking")
print("looking at", inputs()[0].name, flush=True)
while parameters()["wait"]:
    time.sleep(0.1)
report.metric("size", inputs()[0].stat().st_size, unit="B", file=inputs()[0])
report.finding("warning", "few.messages", "fewer than it should have", file=inputs()[0], topic="/imu/data")
report.propose(sensors=["imu"])
(out / "counts.csv").write_text("topic,count")
report.mission_file("counts.csv", "derived/counts.csv")
"""


@pytest.fixture(scope="module")
def instance(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Instance]:
    """An instance without an engine and with one account, because runs as processes require a single account."""
    home = tmp_path_factory.mktemp("up")
    with running_instance(home, DOCKER_HOST=f"unix://{home}/nothing") as running:
        yield running


@pytest.fixture
def mission(terminal: Terminal, project: str, tmp_path: Path) -> tuple[str, ...]:
    """A mission with recordings; returns the options that select it."""
    terminal.run("sample", tmp_path / "drive", "--size", "5MB", "--format", "mcap", "--format", "bag")
    terminal.run("upload", "-p", project, "-m", "drive", "--create", "--wait", tmp_path / "drive")
    return "-p", project, "-m", "drive"


def test_a_run_is_followed_downloaded_reused_and_shown_in_the_lineage(
    terminal: Terminal, mission: tuple[str, ...], project: str, tmp_path: Path
) -> None:
    (tmp_path / "look.py").write_text(WHOLE)
    terminal.run("action", "create", tmp_path / "look.py", "-p", project)

    ran = terminal.run("action", "run", "look", *mission, "--follow")
    assert "looking at drive.bag" in ran.err
    size = (tmp_path / "drive" / "drive.bag").stat().st_size
    assert re.search(rf"^size +{size} +B ", ran.out, re.MULTILINE)
    (run,) = terminal.run("run", "list", "-p", project, "--json").json()["items"]
    assert (run["state"], run["action"]["name"], run["action"]["version"]) == ("done", "look", 1)
    assert terminal.run("run", "info", run["id"], "--json").json()["metadata"] == {"sensors": ["imu"]}
    (metric,) = terminal.run("run", "metrics", run["id"], "--json").json()["items"]
    assert (metric["metric"]["value"], metric["metric"]["file"]) == (size, "drive/drive.bag")
    (finding,) = terminal.run("run", "findings", "-p", project, "--name", "few.*", "--json").json()["items"]
    assert finding["finding"]["topic"] == "/imu/data"
    assert "looking at drive.bag\n" in terminal.run("run", "logs", run["id"]).out
    terminal.run("run", "artifacts", run["id"], "--download", tmp_path / "back")
    assert (tmp_path / "back" / "counts.csv").read_text() == "topic,count"

    made = terminal.run("lineage", "derived/counts.csv", *mission, "--json").json()["made_by"]
    assert made["run"]["id"] == run["id"]
    assert [entry["path"] for entry in made["inputs"]] == ["drive/drive.bag"]
    (reader,) = terminal.run("lineage", "drive/drive.bag", *mission, "--json").json()["read_by"]
    assert [entry["path"] for entry in reader["files"]] == ["derived/counts.csv"]

    again = terminal.run("action", "run", "look@1", *mission, "--json").json()["items"][0]["run"]
    assert (again["state"], again["reuses_id"]) == ("done", run["id"])
    terminal.run("run", "artifacts", again["id"], "counts.*", "--download", tmp_path / "again")
    assert (tmp_path / "again" / "counts.csv").read_text() == "topic,count"
    retried = terminal.run("run", "retry", run["id"], "--force", "--follow", "--json").json()
    assert (retried["state"], retried["reuses_id"]) == ("done", None)
    assert retried["cause"]["retry_of_id"] == run["id"]


def test_ending_the_log_view_does_not_stop_the_run(
    terminal: Terminal, mission: tuple[str, ...], project: str, tmp_path: Path
) -> None:
    (tmp_path / "look.py").write_text(WHOLE)
    following = terminal.start("action", "run", tmp_path / "look.py", *mission, "--set", "wait=true", "--follow")
    listed = ("run", "list", "-p", project, "--state", "running", "--json")
    wait_until(lambda: bool(terminal.run(*listed).json()["items"]), "a run that is running")
    (run,) = terminal.run(*listed).json()["items"]
    wait_until(lambda: "looking at" in terminal.run("run", "logs", run["id"]).out, "its first log line")
    following.send_signal(signal.SIGINT)
    left = end(following)
    assert left.code == 130
    assert f"klein run cancel {run['id']}" in left.err

    terminal.run("run", "cancel", run["id"])
    ended = terminal.run("run", "logs", "-f", run["id"], code=14)
    assert "looking at drive.bag" in ended.err
    assert "cancelled: " in ended.err
    assert terminal.run("run", "info", run["id"], "--json").json()["reason"] == "cancelled"


def test_an_action_runs_on_each_mission_of_a_search(
    terminal: Terminal, mission: tuple[str, ...], project: str, tmp_path: Path
) -> None:
    terminal.run("mission", "create", "empty", "-p", project)
    (tmp_path / "look.py").write_text(WHOLE)
    run = ("action", "run", tmp_path / "look.py", "--query", f"project:{project}")

    assert "--yes" in terminal.run(*run, code=2).err
    ran = terminal.run(*run, "--yes", "--follow", "--json", code=None)
    outcomes = {entry["outcome"]: entry for entry in ran.json()["items"]}
    assert outcomes["created"]["run"]["state"] == "done"
    assert outcomes["refused"]["problem"]["code"] == "no_inputs"
    assert f"{project}/empty: No file of the mission" in ran.err
    assert ran.code == terminal.run("action", "run", tmp_path / "look.py", "-m", "empty", "-p", project, code=None).code
