"""Checks and verdicts in a real browser: rules, the matrix, a check accepted, an action, verdicts everywhere."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.conftest import Terminal
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_GOOD = "good <b>one<b>"
_BAD = "bad <img src=x onerror=alert(1)>"
_RULES = """\
version: 1
profiles:
  - name: every <b>vehicle<b>
    topics:
      /imu/data: {rate: 200 Hz, tolerance: 30%, max_gap: 500ms}
      /odom: {rate: 50 Hz, severity: warning}
      "/gps/*": {}
      /camera/image/compressed: {covers: 80%}
    images:
      /camera/image/compressed: {}
  - name: legs
    when: {robot: anymal}
    topics:
      /joints: {}
"""
_WRONG_RULES = _RULES.replace("rate: 50 Hz", "raet: 50 Hz")
_REPORT = {
    "checks": [
        {
            "name": "image.black",
            "status": "error",
            "message": "17 of <b>20<b> pictures are black",
            "value": 17,
            "limit": 2,
            "topic": "/camera/image/compressed",
        },
        {
            "name": "imu.gravity",
            "status": "ok",
            "message": "it is",
            "value": 9.81,
            "unit": "m/s²",
            "topic": "/imu/data",
        },
    ],
    "metrics": [{"name": "ate_rmse", "value": 0.12, "unit": "m", "topic": "/odom", "labels": {"method": "icp"}}],
}
_SCRIPT = f"""\
# /// script
# [tool.kleinkram]
# name = "verify"
# ///
from kleinkram.action import out

(out / "report.json").write_text({json.dumps(_REPORT)!r})
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_verdicts_are_in_sight_explained_and_overruled(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    project, missions = _create_missions(cluster.terminal, tmp_path)
    arguments = {"project": project, "missions": missions, "rules": _RULES, "wrong": _WRONG_RULES}

    results = run_browser("checks.mjs", cluster, pictures, json.dumps(arguments))

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["executed"] == [], "markup was run"
    _check_rules(results)
    _check_matrix(results)
    _check_mission(results)
    assert "Runs when the files of a mission have not changed for 24 h 00 min." in results["actions"]["added"]
    assert results["actions"]["left"] == 0
    assert results["detailsEnd"] <= 360, "on a phone, the button for the hidden columns is in sight"
    assert results["home"].startswith("1 mission failed checks since Monday")
    assert results["run"]["state"] == "Done: bad", "a run that found errors is not green"
    checks = results["run"]["checks"]
    assert 0 < checks.index("image.black") < checks.index("imu.gravity"), "what failed comes first"
    assert "method: icp" in results["run"]["metrics"]
    accepted = cluster.terminal.run("audit", "--json").out
    assert "the gap was a stop" in accepted, "the reason is in the audit log"


def _create_missions(terminal: Terminal, tmp_path: Path) -> tuple[str, dict[str, str]]:
    terminal.run("sample", tmp_path / "good", "--size", "2MB", "--format", "mcap")
    defects = [option for defect in ("gap", "dropped-topic", "wrong-rate") for option in ("--defect", defect)]
    terminal.run("sample", tmp_path / "bad", "--size", "2MB", "--format", "mcap", *defects)
    terminal.run("project", "create", "Alps")
    for mission, folder in ((_GOOD, "good"), (_BAD, "bad")):
        terminal.run("upload", "-p", "Alps", "-m", mission, "--create", "--wait", f"{tmp_path / folder}/")
    script = tmp_path / "verify.py"
    script.write_text(_SCRIPT)
    terminal.run("action", "run", script, "-p", "Alps", "-m", _BAD, "--follow", code=15)
    script.write_text(_SCRIPT.replace('"verify"', '"verify all"'))
    terminal.run("action", "create", script, "-p", "Alps")
    (project,) = terminal.run("project", "list", "--json").json()["items"]
    missions = terminal.run("mission", "list", "--json").json()["items"]
    names = {_GOOD: "good", _BAD: "bad"}
    return project["id"], {names[mission["name"]]: mission["id"] for mission in missions}


def _check_rules(results: dict[str, Any]) -> None:
    rules = results["rules"]
    assert rules["fault"].startswith("Line 6, column"), "the error names its place"
    assert "did you mean 'rate'?" in rules["fault"]
    assert rules["markedLine"] == "6"
    assert rules["caretLine"] == 6, "the caret is at the error"
    assert rules["versions"] == 2
    assert rules["added"] == ["# a comment"]
    assert rules["removed"] == []


def _check_matrix(results: dict[str, Any]) -> None:
    matrix = results["matrix"]
    assert matrix["missions"] == 2
    assert matrix["bad"]["topic.missing"] == "error"
    assert matrix["bad"]["topic.gap"] == "error"
    assert matrix["bad"]["topic.rate"] == "warning", "the rule's severity"
    assert matrix["good"]["topic.missing"] == "ok"
    assert matrix["good"]["image.black"] == "needs_content", "what only the index was read for is not green"
    assert matrix["afterArrows"] == {"row": "1", "column": "2"}
    assert "longest gap" in matrix["explained"]
    assert matrix["opened"].startswith("/missions/")
    assert matrix["trend"] == ["1 bad", "1 unchecked"]
    assert matrix["accepted"] == "topic.gap: Accepted"


def _check_mission(results: dict[str, Any]) -> None:
    mission = results["mission"]
    assert mission["verdict"] == "bad"
    assert mission["statuses"][0] == "Error"
    assert "legs" in mission["leftOut"], "why a profile was not applied is said"
    assert mission["missingReason"] == "Enter a reason."
    assert mission["afterAccepting"]["topic.gap"] == "Accepted"
    assert "topic.gap on /imu/data, 1 failure: the gap was a stop" in mission["acceptances"]
    assert mission["note"].startswith("seen by <b>Ada<b>")
    assert mission["afterWithdrawing"]["topic.gap"] == "Error"
    assert mission["history"] == "withdrawn"
    assert mission["inProject"] == {"good": "unchecked", "bad": "bad"}, "its pictures were not checked yet"
    assert mission["inSearch"] == ["bad"]
    assert (mission["worstFirst"], mission["bestFirst"]) == (["bad", "unchecked"], ["unchecked", "bad"])
