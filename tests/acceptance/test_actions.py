"""Actions, as who writes one meets them."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.conftest import Instance, Terminal, end, wait_until

SCRIPT = """\
# /// script
# dependencies = ["packaging"]
# [tool.kleinkram]
# inputs = {paths = ["*.mcap"]}
# parameters = [{name = "topic", type = "topic", default = "/imu"}, {name = "code", type = "integer", default = 0}]
# ///
from kleinkram.action import context, inputs, out, parameters, progress, report

for number, path in enumerate(inputs()):
    progress(number / len(inputs()), path.name)
    print("looking at", path, flush=True)
    report.metric("messages", sum(topic.count or 0 for topic in context().topics), file=path)
    report.finding("warning", "few", "fewer than it should have", file=path, topic=parameters()["topic"])
(out / "tables").mkdir()
(out / "tables" / "counts.csv").write_text("topic,count")
(out / "outside").symlink_to("/etc/passwd")
report.propose(sensors=["imu"])
raise SystemExit(parameters()["code"])
"""


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
report.put_back("counts.csv", "derived/counts.csv")
"""


@pytest.fixture(scope="session")
def runner(instance: Instance, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A runner of the instance: its own, where it has one, else one beside it."""
    if "runner" in instance.told()["parts"]:
        yield
        return
    home = tmp_path_factory.mktemp("runner")
    owner = Terminal(home, {**os.environ, "KLEINKRAM_DATA_DIR": str(instance.data_dir), "XDG_CONFIG_HOME": str(home)})
    token = owner.run("token", "create", "runner-of-tests", "--kind", "runner").out.strip()
    options = {"url": instance.told()["url"], "data_dir": str(home / "data"), "name": "beside", "executor": "process"}
    command = [sys.executable, "-m", "kleinkram.runner", json.dumps(options)]
    with (home / "log").open("wb") as log:
        process = subprocess.Popen(command, env={**os.environ, "KLEINKRAM_RUNNER_TOKEN": token}, stderr=log)
    yield
    process.send_signal(signal.SIGINT)
    process.wait(timeout=30)


@pytest.fixture
def mission(terminal: Terminal, project: str, tmp_path: Path) -> tuple[str, ...]:
    """A mission with recordings; says how to name it."""
    terminal.run("sample", tmp_path / "drive", "--size", "5MB", "--format", "mcap", "--format", "bag")
    terminal.run("upload", "-p", project, "-m", "drive", "--create", "--wait", tmp_path / "drive")
    return "-p", project, "-m", "drive"


def test_a_script_runs_on_a_mission(terminal: Terminal, mission: tuple[str, ...], tmp_path: Path) -> None:
    script = tmp_path / "look.py"
    script.write_text(SCRIPT)
    run = ["action", "run-local", script, *mission, "--out"]

    ran = terminal.run(*run, tmp_path / "out", "--json")
    assert "looking at /in/drive/drive.mcap" in ran.err
    assert "outside is a link: left out" in ran.err
    said = ran.json()
    assert (said["reason"], said["artifacts"]) == ("done", [{"path": "tables/counts.csv", "size_bytes": 11}])
    (metric,) = said["report"]["metrics"]
    assert (metric["name"], metric["file"]) == ("messages", "drive/drive.mcap")
    assert metric["value"] > 0
    assert said["report"]["metadata"] == {"sensors": ["imu"]}
    assert (tmp_path / "out" / "tables" / "counts.csv").read_text() == "topic,count"

    again = terminal.run(*run, tmp_path / "out", code=2)
    assert "holds something already" in again.err
    failed = terminal.run(*run, tmp_path / "failed", "--set", "code=3", code=14)
    assert "the exit code 3" in failed.err
    unknown = terminal.run(*run, tmp_path / "unknown", "--set", "topc=/imu", code=2)
    assert "no parameter 'topc'; it has topic, code" in unknown.err


@pytest.mark.slow
def test_what_cannot_be_run_is_told(terminal: Terminal, mission: tuple[str, ...], tmp_path: Path) -> None:
    script = tmp_path / "look.py"
    run = ["action", "run-local", script, *mission, "--out", tmp_path / "out"]
    for header, code, why in (
        ('dependencies = ["nonsense-that-nobody-made>=2"]', 14, "needs what is not installed here: nonsense"),
        ('[tool.kleinkram]\n# inputs = {paths = ["*.csv"]}', 3, "No file of the mission drive is an input of look"),
        ("[tool.kleinkram]\n# privileged = true", 2, "privileged: Extra inputs"),
        ("dependencies = [", 2, "its header is not TOML"),
    ):
        script.write_text(f"# /// script\n# {header}\n# ///\n")
        assert why in terminal.run(*run, code=code).err

    script.write_text("open('/out/report.json', 'w').write('{\"metrics\": [{\"name\": 5}]}')")
    said = json.loads(terminal.run(*run, "--json", code=14).out)
    assert said["reason"] == "broken_report"
    assert "metrics.0.name" in said["message"]


@pytest.mark.slow
def test_the_actions_on_the_page_run(terminal: Terminal, mission: tuple[str, ...], tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "actions.md").read_text()
    blocks = dict(re.findall(r"<!-- (\w+) -->\n```python\n(.*?)```", page, re.DOTALL))
    for name, code in blocks.items():
        (tmp_path / f"{name}.py").write_text(code)

    told = terminal.run("action", "run-local", tmp_path / "script.py", *mission, "--out", tmp_path / "out-1", "--json")
    assert {each["name"] for each in told.json()["report"]["metrics"]} == {"messages"}
    assert "Running count as a p" in told.err
    told = terminal.run("action", "run-local", tmp_path / "bare.py", *mission, "--out", tmp_path / "out-2", "--json")
    sizes = {each["file"]: each["value"] for each in told.json()["report"]["metrics"]}
    assert sizes == {f"drive/{each.name}": each.stat().st_size for each in (tmp_path / "drive").iterdir()}
    assert told.json()["report"]["previews"] == [{"path": "sizes.csv", "title": "Sizes"}]


@pytest.mark.slow
@pytest.mark.usefixtures("runner")
def test_a_run_is_followed_fetched_reused_and_leaves_its_lineage(
    terminal: Terminal, mission: tuple[str, ...], project: str, tmp_path: Path
) -> None:
    (tmp_path / "look.py").write_text(WHOLE)
    terminal.run("action", "create", tmp_path / "look.py", "-p", project)

    ran = terminal.run("action", "run", "look", *mission, "--follow")
    assert "looking at drive.bag" in ran.err
    size = (tmp_path / "drive" / "drive.bag").stat().st_size
    assert f"size    {float(size)}  B" in ran.out
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
    assert [each["path"] for each in made["inputs"]] == ["drive/drive.bag"]
    (reader,) = terminal.run("lineage", "drive/drive.bag", *mission, "--json").json()["read_by"]
    assert [each["path"] for each in reader["files"]] == ["derived/counts.csv"]

    again = terminal.run("action", "run", "look@1", *mission, "--json").json()["items"][0]["run"]
    assert (again["state"], again["reuses_id"]) == ("done", run["id"])
    terminal.run("run", "artifacts", again["id"], "counts.*", "--download", tmp_path / "again")
    assert (tmp_path / "again" / "counts.csv").read_text() == "topic,count"
    retried = terminal.run("run", "retry", run["id"], "--force", "--follow", "--json").json()
    assert (retried["state"], retried["reuses_id"]) == ("done", None)
    assert retried["cause"]["retry_of_id"] == run["id"]


@pytest.mark.slow
@pytest.mark.usefixtures("runner")
def test_who_stops_following_does_not_stop_the_run(
    terminal: Terminal, mission: tuple[str, ...], project: str, tmp_path: Path
) -> None:
    (tmp_path / "look.py").write_text(WHOLE)
    following = terminal.start("action", "run", tmp_path / "look.py", *mission, "--set", "wait=true", "--follow")
    listed = ("run", "list", "-p", project, "--state", "running", "--json")
    wait_until(lambda: bool(terminal.run(*listed).json()["items"]), "a run that is running")
    (run,) = terminal.run(*listed).json()["items"]
    wait_until(lambda: "looking at" in terminal.run("run", "logs", run["id"]).out, "its first words")
    following.send_signal(signal.SIGINT)
    left = end(following)
    assert left.code == 130
    assert f"klein run cancel {run['id']}" in left.err

    terminal.run("run", "cancel", run["id"])
    ended = terminal.run("run", "logs", "-f", run["id"], code=14)
    assert "looking at drive.bag" in ended.err
    assert "cancelled: " in ended.err
    assert terminal.run("run", "info", run["id"], "--json").json()["reason"] == "cancelled"


@pytest.mark.slow
@pytest.mark.usefixtures("runner")
def test_each_mission_of_a_search_is_run_on(
    terminal: Terminal, mission: tuple[str, ...], project: str, tmp_path: Path
) -> None:
    terminal.run("mission", "create", "empty", "-p", project)
    (tmp_path / "look.py").write_text(WHOLE)
    run = ("action", "run", tmp_path / "look.py", "--query", f"project:{project}")

    assert "--yes" in terminal.run(*run, code=2).err
    ran = terminal.run(*run, "--yes", "--follow", "--json", code=None)
    outcomes = {each["outcome"]: each for each in ran.json()["items"]}
    assert outcomes["made"]["run"]["state"] == "done"
    assert outcomes["refused"]["problem"]["code"] == "no_inputs"
    assert f"{project}/empty: No file of the mission" in ran.err
    assert ran.code == terminal.run("action", "run", tmp_path / "look.py", "-m", "empty", "-p", project, code=None).code
