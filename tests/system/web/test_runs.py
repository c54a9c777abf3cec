"""Runs in a real browser: launched with a form, watched live, with reports and artifacts shown as text."""

from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.conftest import Terminal
from tests.system.cluster import Cluster
from tests.system.web.conftest import Act

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
# Those on many missions last until they are ended.
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
@pytest.mark.timeout(280)
def test_a_run_from_form_to_lineage(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    cluster.start()
    _filled(cluster.terminal, tmp_path)

    seen = act("runs.mjs", cluster, pictures)

    assert seen["complaints"] == []
    assert seen["axe"] == []
    assert seen["wide"] == []
    assert seen["ran"] == [], "markup was run"
    assert seen["wrong"] == ["Required.", "Enter at most 10."]
    assert "/imu/data" in seen["topics"], "the mission's topics are offered"
    assert seen["live"]["progress"] == "half of it", "what it is at is seen while it runs"
    log = seen["log"]
    assert log["last"] == "the very end"
    assert log["drawn"] < 100, "only the lines in sight are drawn"
    assert log["found"] == "1 of 1"
    assert "line 1234" in log["inSight"]
    _check_report(seen)
    _check_links(seen, cluster.terminal)


def _filled(terminal: Terminal, tmp_path: Path) -> None:
    terminal.run("sample", tmp_path / "drive", "--size", "1MB", "--format", "mcap")
    terminal.run("project", "create", "Alps")
    for mission in (_MARKUP, "night"):
        terminal.run("upload", "-p", "Alps", "-m", mission, "--create", "--wait", tmp_path / "drive")
    script = tmp_path / "look.py"
    script.write_text(_SCRIPT)
    terminal.run("action", "create", script, "-p", "Alps")


def _check_report(seen: dict[str, Any]) -> None:
    (finding,) = seen["findings"]
    assert "nothing <i>for a while<i>" in finding
    assert seen["findingLeadsTo"].startswith("/files/")
    assert "topic=%2Fimu%2Fdata" in seen["findingLeadsTo"].replace("topic=/imu/data", "topic=%2Fimu%2Fdata")
    (metric,) = seen["metrics"]
    assert metric.split("\n")[:2] == ["ate_rmse", "0.12 m"]
    assert seen["previews"] == {
        "pictures": 1,
        "inline": 0,
        "track": "A track of 3 points",
        "cells": ["<img src=x onerror=alert(5)>", "1"],
    }
    assert sorted(path for path in seen["artifacts"] if "." in path) == ["plot.svg", "table.csv", "track.geojson"]
    assert seen["downloaded"] == "table.csv"
    assert seen["taken"]["robot"] == "anymal <b>3<b>"


def _check_links(seen: dict[str, Any], terminal: Terminal) -> None:
    assert "Used by look <b>closely<b>" in seen["lineage"]
    assert "derived/<b>table<b>.csv" in seen["deletion"], "what came of it is told before it is deleted"
    assert seen["again"]["state"] == "done"
    assert seen["many"]["made"] == "2 runs started"
    assert len(seen["many"]["runs"]) == 4
    assert seen["cancelled"] == "cancelled"
    runs = terminal.run("run", "list", "--json").json()["items"]
    assert {run["mission"]["name"] for run in runs} == {_MARKUP, "night"}
