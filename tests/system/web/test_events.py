"""Events of missions in a real browser: keys, marks, lists, searches, live pages, rights."""

import json
from pathlib import Path

import pytest

from kleinkram.client import connect
from kleinkram.recordings.sample import generate_mcap
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_SCRIPT = """\
# /// script
# [tool.kleinkram]
# name = "look"
# description = "Reports a finding."
# inputs = {paths = ["*.mcap"]}
# ///
from kleinkram.action import report

report.finding("warning", "imu.gap", "The IMU was silent.", topic="/imu/data", time_ns=TIME_NS)
"""
# The API rounds times to doubles, and the viewer adds as much, so that the message of a time is shown.
_ROUNDING_NS = 512
_SECOND = 10**9


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_events_are_added_by_keys_searched_and_cut(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    day = tmp_path / "day"
    day.mkdir()
    truth = generate_mcap(day / "drive.mcap", size_bytes=10_000_000)
    script = tmp_path / "look.py"
    script.write_text(_SCRIPT.replace("TIME_NS", str(truth.start_ns + _SECOND)))
    terminal.run("project", "create", "Alps")
    terminal.run("action", "create", script, "-p", "Alps")
    terminal.run("upload", "-p", "Alps", "-m", "day", "--create", "--wait", f"{day}/")
    terminal.run("action", "run", "look", "-p", "Alps", "-m", "day", "--follow", "--yes")
    invited = terminal.run("person", "invite", "grace@example.org", "--name", "Grace", "--json").json()
    terminal.run("access", "grant", "READ", "--to", "grace@example.org", "-p", "Alps")
    files = terminal.run("file", "list", "-p", "Alps", "--json").json()["items"]
    file = next(row for row in files if row["path"] == "drive.mcap")
    ids = {"invitation": invited["url"], "mission": file["mission"]["id"], "file": file["id"]}
    ids["share"] = terminal.run("share", "create", "-p", "Alps", "-m", "day").out.strip()
    results = run_browser("events.mjs", cluster, json.dumps(ids), pictures, timeout_s=560)

    assert results["consoleErrors"] == []
    assert results["executed"] == [], "markup was run"
    assert results["axe"] == []
    assert results["overflowing"] == []
    moment_ns, from_ns, to_ns = (int(results[name]) for name in ("momentAt", "spanFrom", "spanTo"))
    assert moment_ns < from_ns < to_ns
    assert "stumble" in results["moment"]
    assert "No span was begun" in results["noBegin"]
    assert results["spanButton"] == "End the span here"
    assert results["otherRows"] == ["stumble", "trot"]
    assert results["hint"].startswith("trot · ")
    _assert_near(results["clicked"], from_ns)
    _assert_near(results["previous"], moment_ns)
    _assert_near(results["byRow"], from_ns)
    assert results["ofFinding"] == ["imu.gap", "The IMU was silent."]
    assert "changed" in results["conflict"].lower()
    assert sorted(results["missionRows"]) == ["imu.gap", "slip", "trot"]
    _assert_near(results["fromSearch"], from_ns)
    assert results["fileLink"].startswith(f"/files/{file['id']}/view?t=")
    assert results["commands"][0].startswith("klein cut -p Alps -m day --start ")
    assert results["commands"][-1] == "klein cut --event '*' --around 5s -p Alps -m day -o events"
    around = max(truth.start_ns, from_ns - 5 * _SECOND), min(truth.end_ns, to_ns + 5 * _SECOND)
    expected_s = [(time_ns - truth.start_ns) / _SECOND for time_ns in around]
    assert [float(text) for text in results["cutRange"]] == pytest.approx(expected_s, abs=0.002)
    assert results["readerButtons"] == ["Cut slip"]
    assert results["readerAdds"] == 0
    assert results["readerForms"] == 0
    guest = results["guest"]
    assert (guest["forms"], guest["adds"], guest["buttons"]) == (0, 0, []), "a link changes and cuts nothing"
    _assert_near(guest["time"], moment_ns)
    assert sorted(results["left"]) == ["imu.gap", "trot"]
    with connect(cluster.runtime_info()["url"], (cluster.data_dir / "owner-token").read_text().strip()) as client:
        left = {event.name: event for event in client.mission_events.list(mission=ids["mission"])}
    assert set(left) == {"imu.gap", "trot"}
    _assert_near(left["trot"].start_ns, from_ns)
    _assert_near(left["trot"].end_ns or 0, to_ns)
    assert left["imu.gap"].finding_id is not None
    assert left["imu.gap"].topic == "/imu/data"


def _assert_near(actual: object, expected_ns: int) -> None:
    assert abs(int(str(actual)) - expected_ns) <= 2 * _ROUNDING_NS
