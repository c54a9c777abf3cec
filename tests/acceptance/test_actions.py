"""Actions are written, tested and run on the author's own machine."""

import json
import re
from pathlib import Path

import pytest

from tests.acceptance.conftest import Terminal

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


@pytest.fixture
def mission(terminal: Terminal, project: str, tmp_path: Path) -> tuple[str, ...]:
    """A mission with recordings; returns the options that select it."""
    terminal.run("sample", tmp_path / "drive", "--size", "5MB", "--format", "mcap", "--format", "bag")
    terminal.run("upload", "-p", project, "-m", "drive", "--create", "--wait", tmp_path / "drive")
    return "-p", project, "-m", "drive"


def test_a_script_runs_on_a_mission(terminal: Terminal, mission: tuple[str, ...], tmp_path: Path) -> None:
    script = tmp_path / "look.py"
    script.write_text(SCRIPT)
    command = ["action", "run-local", script, *mission, "--out"]

    ran = terminal.run(*command, tmp_path / "out", "--json")
    assert "looking at /in/drive/drive.mcap" in ran.err
    assert "outside is a link: left out" in ran.err
    run = ran.json()
    assert (run["reason"], run["artifacts"]) == ("done", [{"path": "tables/counts.csv", "size_bytes": 11}])
    (metric,) = run["report"]["metrics"]
    assert (metric["name"], metric["file"]) == ("messages", "drive/drive.mcap")
    assert metric["value"] > 0
    assert run["report"]["metadata"] == {"sensors": ["imu"]}
    assert (tmp_path / "out" / "tables" / "counts.csv").read_text() == "topic,count"

    again = terminal.run(*command, tmp_path / "out", code=2)
    assert "it is not empty" in again.err
    failed = terminal.run(*command, tmp_path / "failed", "--set", "code=3", code=14)
    assert "the exit code 3" in failed.err
    unknown = terminal.run(*command, tmp_path / "unknown", "--set", "topc=/imu", code=2)
    assert "no parameter 'topc'; it has topic, code" in unknown.err


@pytest.mark.slow
def test_errors_name_the_reason_why_an_action_cannot_run(
    terminal: Terminal, mission: tuple[str, ...], tmp_path: Path
) -> None:
    script = tmp_path / "look.py"
    run = ["action", "run-local", script, *mission, "--out", tmp_path / "out"]
    for header, code, why in (
        ('dependencies = ["unknown-package-of-tests>=2"]', 14, "are not installed here: unknown-package-of-tests"),
        ('[tool.kleinkram]\n# inputs = {paths = ["*.csv"]}', 3, "No file of the mission drive is an input of look"),
        ("[tool.kleinkram]\n# privileged = true", 2, "privileged: there is no such field"),
        ("dependencies = [", 2, "its header is not TOML"),
    ):
        script.write_text(f"# /// script\n# {header}\n# ///\n")
        assert why in terminal.run(*run, code=code).err

    script.write_text("open('/out/report.json', 'w').write('{\"metrics\": [{\"name\": 5}]}')")
    run = json.loads(terminal.run(*run, "--json", code=14).out)
    assert run["reason"] == "broken_report"
    assert "metrics.0.name" in run["message"]


@pytest.mark.slow
def test_the_actions_on_the_page_run(terminal: Terminal, mission: tuple[str, ...], tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "actions.md").read_text()
    blocks = dict(re.findall(r"<!-- (\w+) -->\n```python\n(.*?)```", page, re.DOTALL))
    for name, code in blocks.items():
        (tmp_path / f"{name}.py").write_text(code)

    result = terminal.run(
        "action", "run-local", tmp_path / "script.py", *mission, "--out", tmp_path / "out-1", "--json"
    )
    assert {metric["name"] for metric in result.json()["report"]["metrics"]} == {"messages"}
    assert "Running count as a p" in result.err
    result = terminal.run("action", "run-local", tmp_path / "bare.py", *mission, "--out", tmp_path / "out-2", "--json")
    sizes = {metric["file"]: metric["value"] for metric in result.json()["report"]["metrics"]}
    assert sizes == {f"drive/{metric.name}": metric.stat().st_size for metric in (tmp_path / "drive").iterdir()}
    assert result.json()["report"]["previews"] == [{"path": "sizes.csv", "title": "Sizes"}]
