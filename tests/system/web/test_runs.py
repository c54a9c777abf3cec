"""Runs in a real browser: launched with a form, watched live, with reports and artifacts shown as text."""

from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.conftest import Terminal
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_MARKUP = "Wet <img src=x onerror=alert(1)>"
_SCRIPT = """\
# /// script
# [tool.kleinkram]
# name = "look <b>closely<b>"
# description = "Looks <script>alert(1)</script> at every file."
# inputs = {paths = ["*.mcap"]}
# right = "CREATE"
# parameters = [
#   {name = "top", type = "topic"},
#   {name = "speed", type = "number", unit = "m/s", minimum = 0, maximum = 10, default = 2.5},
#   {name = "way", type = "choice", choices = ["fast", "well"], default = "well"},
#   {name = "slow", type = "boolean", default = false},
# ]
# ///
import json
import time
from kleinkram.action import inputs, out, parameters, progress, report

values = parameters()
print("values", values, "<img src=x onerror=alert(2)>", flush=True)
for number in range(3000):
    print("line", number)
(path,) = inputs()
progress(0.5, "half of it")
# Runs on several missions continue until they are cancelled.
time.sleep((600 if values["top"] == "/odom" else 15) if values["slow"] else 0)
report.metric("ate_rmse", 0.12, unit="m", file=path)
where = {"file": path, "topic": values["top"], "time_ns": 1_700_000_000_000_000_000}
report.finding("warning", "gap", "nothing <i>for a while<i>", **where)
head = '<svg xmlns="http://www.w3.org/2000/svg" width="40" height="40" onload="alert(3)">'
(out / "plot.svg").write_text(head + '<script>alert(4)</script><circle r="20"/></svg>')
line = [[8.5, 47.3], [8.501, 47.3], [8.501, 47.301]]
(out / "track.geojson").write_text(json.dumps({"type": "LineString", "coordinates": line}))
(out / "table.csv").write_text('name,value\\n"<img src=x onerror=alert(5)>",1\\n')
report.preview("plot.svg", title="A plot")
report.preview("track.geojson", title="Where it went")
report.preview("table.csv", title="Numbers")
report.mission_file("table.csv", "derived/<b>table<b>.csv")
report.propose(robot="anymal <b>3<b>", distance_m=42.5)
print("the very end", flush=True)
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_run_is_launched_watched_and_followed_to_its_lineage(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    _create_objects(cluster.terminal, tmp_path)

    results = run_browser("runs.mjs", cluster, pictures)

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["executed"] == [], "markup was run"
    assert results["fieldErrors"] == ["Required.", "Enter at most 10."]
    assert "/imu/data" in results["topics"], "the mission's topics are offered"
    assert results["active"]["progress"] == "half of it", "progress is shown while it runs"
    log = results["log"]
    assert log["last"] == "the very end"
    assert log["renderedLines"] < 100, "only visible lines are rendered"
    assert log["matches"] == "1 of 1"
    assert "line 1234" in log["visibleLines"]
    _check_report(results)
    _check_links(results, cluster.terminal)


def _create_objects(terminal: Terminal, tmp_path: Path) -> None:
    terminal.run("sample", tmp_path / "drive", "--size", "1MB", "--format", "mcap")
    terminal.run("project", "create", "Alps")
    for mission in (_MARKUP, "night"):
        terminal.run("upload", "-p", "Alps", "-m", mission, "--create", "--wait", tmp_path / "drive")
    script = tmp_path / "look.py"
    script.write_text(_SCRIPT)
    terminal.run("action", "create", script, "-p", "Alps")


def _check_report(results: dict[str, Any]) -> None:
    (finding,) = results["findings"]
    assert "nothing <i>for a while<i>" in finding
    assert results["findingLink"].startswith("/files/")
    assert "topic=%2Fimu%2Fdata" in results["findingLink"].replace("topic=/imu/data", "topic=%2Fimu%2Fdata")
    (metric,) = results["metrics"]
    assert metric.split("\n")[:2] == ["ate_rmse", "0.12 m"]
    assert results["previews"] == {
        "pictures": 1,
        "inline": 0,
        "track": "A track of 3 points",
        "cells": ["<img src=x onerror=alert(5)>", "1"],
    }
    assert sorted(path for path in results["artifacts"] if "." in path) == ["plot.svg", "table.csv", "track.geojson"]
    assert results["downloaded"] == "table.csv"
    assert results["appliedMetadata"]["robot"] == "anymal <b>3<b>"


def _check_links(results: dict[str, Any], terminal: Terminal) -> None:
    assert "Used by look <b>closely<b>" in results["lineage"]
    assert "derived/<b>table<b>.csv" in results["deletionWarning"], "the dialog names the results made from the file"
    assert results["secondRun"]["state"] == "done"
    assert results["batch"]["launched"] == "2 runs started"
    assert len(results["batch"]["runs"]) == 4
    assert results["cancelled"] == "cancelled"
    runs = terminal.run("run", "list", "--json").json()["items"]
    assert {run["mission"]["name"] for run in runs} == {_MARKUP, "night"}
