"""Missions in a real browser: valid and invalid metadata, many files, rights, names with markup."""

import json
from pathlib import Path

import pytest

from kleinkram.recordings.sample import Faults, TopicGap, generate_bag, generate_mcap
from tests.acceptance.conftest import wait_until
from tests.system.backend import sql
from tests.system.cluster import Cluster
from tests.system.web.conftest import Act

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
# Uploading very many is told elsewhere: here they are names of the bytes of the first.
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
def test_missions(cluster: Cluster, act: Act, pictures: Path, tmp_path: Path) -> None:
    cluster.start()
    terminal = cluster.terminal
    (tmp_path / "fields.yaml").write_text(_FIELDS)
    metadata = tmp_path / "mission.yaml"
    metadata.write_text('robot: anymal\noperator: ada\nplace: "<svg onload=alert(3)>"\n')
    day = tmp_path / "day"
    day.mkdir()
    generate_mcap(day / "drive.mcap", duration_s=5, faults=Faults(gap=TopicGap("/imu/data", 2, 3)))
    generate_bag(day / "cut.bag", duration_s=4, faults=Faults(truncate_to=0.6))
    (day / "<a href=x>.txt").write_text("named by somebody who tries")
    many = tmp_path / "many"
    (many / "scan_00").mkdir(parents=True)
    (many / "scan_00" / "frame_0000.txt").write_text("the bytes that ten thousand names stand for")
    terminal.run("project", "create", _MARKUP, "--fields", tmp_path / "fields.yaml")
    place = ("-p", _MARKUP, "--create", "--metadata", metadata)
    terminal.run("upload", *place, "-m", _MISSION, f"{day}/", "--wait")
    terminal.run("upload", *place, "-m", "many", f"{many}/")
    projects = {row["name"]: row["id"] for row in terminal.run("project", "list", "--json").json()["items"]}
    missions = {row["name"]: row["id"] for row in terminal.run("mission", "list", "--json").json()["items"]}
    sql(cluster, _MANY, missions["many"])
    invited = terminal.run("person", "invite", "grace@example.org", "--name", _GUEST, "--json").json()
    wait_until(lambda: _topics_are_there(cluster, missions[_MISSION]), "the topics to be added up")
    seen = act(
        "missions.mjs",
        cluster,
        invited["url"],
        _GUEST,
        projects[_MARKUP],
        missions[_MISSION],
        missions["many"],
        pictures,
    )

    assert seen["complaints"] == []
    assert seen["ran"] == [], "markup was run"
    assert set(seen["elements"]) == {0}, "markup was made of what people said"
    assert seen["axe"] == []
    assert seen["wide"] == []
    assert seen["title"] == _MISSION
    assert "Must match" in seen["refused"]
    assert "grace" in seen["accepted"]
    assert "ada" not in seen["accepted"].split()
    assert "/imu/data" in seen["topics"]
    assert seen["rows"] == _FILES + _FOLDERS + 1
    assert max(seen["drawn"], seen["drawnAtEnd"]) < 120, "all rows were drawn"
    assert seen["granted"] == _MISSION
    assert "not" in seen["before"], "nobody has given them anything yet"
    assert "not" in seen["revoked"]


def _topics_are_there(cluster: Cluster, mission_id: str) -> bool:
    runtime_info = cluster.terminal.run("mission", "info", mission_id, "--json").json()
    return "/imu/data" in json.dumps(runtime_info)
