"""Missions in a real browser: valid and invalid metadata, many files, rights, names with markup."""

import json
from pathlib import Path

import pytest

from kleinkram.recordings.sample import Faults, TopicGap, generate_bag, generate_mcap
from tests.acceptance.conftest import wait_until
from tests.system.backend import sql
from tests.system.cluster import Cluster
from tests.system.web.conftest import RunBrowser

_FILES = 10_000
_FOLDERS = 20
_MARKUP = "<b>Alps<script>alert(1)"
_MISSION = "<img src=x onerror=alert(2)>"
_FIELDS = """
undeclared: accept
fields:
  - {name: robot, type: choice, choices: [anymal, "<i>spot</i>"], required: true, description: "<u>which</u>"}
  - {name: operator, type: string, pattern: "[a-z]+", required: true}
"""
_GUEST = "Grace Guest"
# Other tests upload many files. Here all files share the bytes of the first.
_MANY = f"""
INSERT INTO file (id, mission_id, blob_id, path, path_key, origin, uploaded_by_id)
  SELECT gen_random_uuid(), mission_id, blob_id, name, name, 'link', uploaded_by_id FROM file,
    LATERAL (
      SELECT 'scan_' || lpad((n %% {_FOLDERS})::text, 2, '0') || '/frame_' || lpad(n::text, 4, '0') || '.txt' AS name
      FROM generate_series(1, {_FILES - 1}) n
    ) AS named
  WHERE mission_id = %s RETURNING id
"""


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_metadata_files_and_rights_of_missions_with_hostile_names(
    cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    cluster.start()
    terminal = cluster.terminal
    (tmp_path / "fields.yaml").write_text(_FIELDS)
    metadata = tmp_path / "mission.yaml"
    metadata.write_text('robot: anymal\noperator: ada\nplace: "<svg onload=alert(3)>"\n')
    day = tmp_path / "day"
    day.mkdir()
    generate_mcap(day / "drive.mcap", duration_s=5, faults=Faults(gap=TopicGap("/imu/data", 2, 3)))
    generate_bag(day / "cut.bag", duration_s=4, faults=Faults(truncate_to=0.6))
    (day / "<a href=x>.txt").write_text("a hostile name")
    many = tmp_path / "many"
    (many / "scan_00").mkdir(parents=True)
    (many / "scan_00" / "frame_0000.txt").write_text("the bytes that ten thousand files share")
    terminal.run("project", "create", _MARKUP, "--fields", tmp_path / "fields.yaml")
    place = ("-p", _MARKUP, "--create", "--metadata", metadata)
    terminal.run("upload", *place, "-m", _MISSION, f"{day}/", "--wait")
    terminal.run("upload", *place, "-m", "many", f"{many}/")
    projects = {row["name"]: row["id"] for row in terminal.run("project", "list", "--json").json()["items"]}
    missions = {row["name"]: row["id"] for row in terminal.run("mission", "list", "--json").json()["items"]}
    sql(cluster, _MANY, missions["many"])
    invited = terminal.run("person", "invite", "grace@example.org", "--name", _GUEST, "--json").json()
    wait_until(lambda: _has_topics(cluster, missions[_MISSION]), "the topics to be merged")
    results = run_browser(
        "missions.mjs",
        cluster,
        invited["url"],
        _GUEST,
        projects[_MARKUP],
        missions[_MISSION],
        missions["many"],
        pictures,
    )

    assert results["consoleErrors"] == []
    assert results["executed"] == [], "markup was run"
    assert set(results["markupElements"]) == {0}, "markup became elements"
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["title"] == _MISSION
    assert "Must match" in results["refused"]
    assert "grace" in results["accepted"]
    assert "ada" not in results["accepted"].split()
    assert "/imu/data" in results["topics"]
    assert results["rows"] == _FILES + _FOLDERS + 1
    assert max(results["renderedRows"], results["renderedRowsAtEnd"]) < 120, "all rows were rendered"
    assert results["granted"] == _MISSION
    assert "not" in results["beforeGrant"], "the person has no rights yet"
    assert "not" in results["revoked"]


def _has_topics(cluster: Cluster, mission_id: str) -> bool:
    runtime_info = cluster.terminal.run("mission", "info", mission_id, "--json").json()
    return "/imu/data" in json.dumps(runtime_info)
