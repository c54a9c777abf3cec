"""Missions in a real browser: metadata, many files, rights, names with markup; sorting, filters, bulk changes."""

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
_LIST_FIELDS = """
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true}
  - {name: temperature, type: number, unit: degC}
  - {name: operator, type: string}
"""
_LISTED = {"cold": ("anymal", -3), "mild": ("spot", 9.5), "hot": ("spot", 21)}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_metadata_files_and_rights_of_missions_with_hostile_names(
    shared_cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    terminal = shared_cluster.terminal
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
    listed = terminal.run("mission", "list", "-p", _MARKUP, "--json").json()["items"]
    missions = {row["name"]: row["id"] for row in listed}
    sql(shared_cluster, _MANY, missions["many"])
    invited = terminal.run("person", "invite", "grace@example.org", "--name", _GUEST, "--json").json()
    wait_until(lambda: _has_topics(shared_cluster, missions[_MISSION]), "the topics to be merged")
    results = run_browser(
        "missions.mjs",
        shared_cluster,
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


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_missions_are_sorted_filtered_changed_and_downloaded_in_bulk(
    shared_cluster: Cluster, run_browser: RunBrowser, pictures: Path, tmp_path: Path
) -> None:
    terminal = shared_cluster.terminal
    (tmp_path / "fields.yaml").write_text(_LIST_FIELDS)
    project = terminal.run("project", "create", "Jura", "--fields", tmp_path / "fields.yaml", "--json").json()
    for name, (robot, temperature) in _LISTED.items():
        folder = tmp_path / name / "notes"
        folder.mkdir(parents=True)
        (folder / "day.txt").write_text(f"It was {name}.")
        metadata = tmp_path / f"{name}.yaml"
        metadata.write_text(f"robot: {robot}\ntemperature: {temperature}\n")
        place = ("-p", "Jura", "-m", name, "--create", "--metadata", metadata)
        terminal.run("upload", *place, f"{tmp_path / name}/")
    # Two names that are equal on systems whose file names may not contain `:`.
    for name in ("a:b.txt", "a_b.txt"):
        (tmp_path / "hot" / name).write_text("Of the same size.")
    terminal.run("upload", "-p", "Jura", "-m", "hot", f"{tmp_path / 'hot'}/")
    share = terminal.run("share", "create", "-p", "Jura", "-m", "hot").out.strip()
    invited = terminal.run("person", "invite", "hedy@example.org", "--name", "Hedy", "--json").json()
    results = run_browser("lists.mjs", shared_cluster, invited["url"], share, project["id"], pictures)

    assert results["consoleErrors"] == []
    assert results["axe"] == []
    assert results["overflowing"] == []
    assert results["ascending"] == ["cold", "mild", "hot"]
    assert results["descending"] == ["hot", "mild", "cold"]
    assert sorted(results["filtered"]) == ["hot", "mild"]
    assert results["downloads"] == ["2 files downloaded.", "0 files downloaded, 2 files already present."]
    assert results["downloadedFiles"] == {f"Jura/{name}/notes/day.txt": f"It was {name}." for name in ("cold", "mild")}
    assert sorted(results["command"].split("\n")) == [
        f"klein download --nested --dest data -p Jura -m {name}" for name in ("cold", "mild")
    ]
    assert results["remaining"] == ["hot"]
    assert "21 degC" in results["details"]
    assert results["shared"].startswith("2 of 3 files downloaded. Failed: ")
    assert "another file has the same name on this computer" in results["shared"]
    assert "You have no access yet" in results["noAccess"][0]
    assert "hedy@example.org" in results["noAccess"][0]
    missions = terminal.run("mission", "list", "-p", "Jura", "--json").json()["items"]
    assert [mission["name"] for mission in missions] == ["hot"]


def _has_topics(cluster: Cluster, mission_id: str) -> bool:
    runtime_info = cluster.terminal.run("mission", "info", mission_id, "--json").json()
    return "/imu/data" in json.dumps(runtime_info)
