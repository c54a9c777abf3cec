"""The main story: a day of recordings is uploaded, found again, and downloaded bit for bit."""

import filecmp
import json
from pathlib import Path

import pytest

from tests.acceptance.conftest import Terminal

FIELDS = """\
undeclared: refuse
fields:
  - {name: robot, type: choice, choices: [anymal, spot], required: true}
  - {name: temperature, type: number, unit: degC, required: true}
  - {name: operator, type: string}
"""


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sample mission."""
    from kleinkram.recordings.sample import generate_mission

    folder = tmp_path_factory.mktemp("field") / "day"
    generate_mission(folder, size_bytes=12_000_000, seed=7)
    return folder


def test_a_day_of_recordings_is_uploaded_searched_and_downloaded(terminal: Terminal, day: Path, tmp_path: Path) -> None:
    fields, metadata = tmp_path / "fields.yaml", tmp_path / "mission.yaml"
    fields.write_text(FIELDS)
    terminal.run("project", "create", "Alps 2026", "--fields", fields)

    form = terminal.run("mission", "template", "Alps 2026").out
    assert "robot" in form
    assert "temperature" in form
    metadata.write_text("robot: anymal\ntemperature: -4\n")
    place = ["-p", "alps 2026", "-m", "Day 1"]  # names ignore case
    uploaded = terminal.run("upload", *place, "--create", "--metadata", metadata, "--wait", f"{day}/", "--json")
    report = uploaded.json()
    assert {item["outcome"] for item in report["items"]} == {"uploaded"}
    paths = {item["path"] for item in report["items"]}
    assert {"drive.mcap", "drive.bag", "drive_rosbag2/metadata.yaml"} <= paths

    mission = terminal.run("mission", "info", *place, "--json").json()
    assert mission["mission"]["metadata"] == {"robot": "anymal", "temperature": -4}
    assert len(mission["recordings"]) == 3
    imu = [topic for topic in mission["topics"] if "imu" in topic["name"]]
    assert imu
    assert all(topic["rate_hz"] == pytest.approx(200, rel=0.05) for topic in imu)
    shown = terminal.run("mission", "info", *place).out
    assert "LONGEST GAP" in shown
    assert "200." in shown

    matches = terminal.run("search", "--topic", "*imu*", "-w", "robot=anymal", "-w", "temperature<0", "--json").json()
    assert {"drive.mcap", "drive.bag"} <= {item["path"] for item in matches["items"]}
    assert terminal.run("search", "--topic", "/no/such/topic", "--json").json() == {"items": []}
    stats = terminal.run("stats", "--by", "metadata.robot", "-p", "Alps 2026", "--json").json()
    assert [(row["group"], row["missions"]) for row in stats["rows"]] == [("anymal", 1)]

    back = tmp_path / "back"
    terminal.run("download", *place, "--dest", back)
    assert {str(path.relative_to(back)) for path in back.rglob("*") if path.is_file()} == paths
    assert all(filecmp.cmp(day / path, back / path, shallow=False) for path in paths)
    terminal.run("verify", *place, f"{day}/")

    completed = terminal.run("mission", "complete", *place, "--json").json()
    assert completed["completed_at"] is not None
    again = terminal.run("mission", "template", "Alps 2026").out
    assert "anymal" in again, "the next form is prefilled from the last mission"


def test_inspect_and_sample_need_no_server(terminal: Terminal, tmp_path: Path) -> None:
    alone = Terminal(terminal.home, {**terminal.environment, "KLEINKRAM_DATA_DIR": str(tmp_path / "none")})
    made = alone.run("sample", tmp_path / "s", "--size", "1MB", "--format", "mcap", "--json").json()
    (truth,) = made["items"]
    (seen,) = alone.run("inspect", tmp_path / "s" / "drive.mcap", "--json").json()["items"]
    assert seen["message_count"] == truth["message_count"]
    assert {topic["name"]: topic["count"] for topic in seen["topics"]} == {
        topic["name"]: topic["count"] for topic in truth["topics"]
    }
    assert "/imu" in alone.run("inspect", tmp_path / "s").out
    alone.run("inspect", tmp_path / "nothing-here", code=2)
    assert "klein up" in alone.run("project", "list", code=2).err


def test_invalid_metadata_is_refused_before_the_upload(terminal: Terminal, tmp_path: Path) -> None:
    fields, metadata, data = tmp_path / "fields.yaml", tmp_path / "mission.yaml", tmp_path / "a.bin"
    fields.write_text(FIELDS)
    data.write_bytes(b"x" * 1000)
    terminal.run("project", "create", "strict", "--fields", fields)
    upload = ["upload", "-p", "strict", "-m", "m", "--create", "--metadata", metadata, data]

    metadata.write_text("temperature: warm\nweather: fine\n")
    refused = terminal.run(*upload, code=6).err
    assert "robot" in refused, "the required field is missing"
    assert "temperature" in refused, "the value has the wrong type"
    assert "weather" in refused, "the field is not declared"
    assert "line 1" in refused

    metadata.write_text("robot: anymal\ntemperature: [1, 2\n")
    broken = terminal.run(*upload, code=6).err
    assert "line" in broken
    assert "column" in broken
    assert terminal.run("mission", "list", "-p", "strict", "--json").json() == {"items": []}


def test_deleted_objects_are_restored_from_the_trash(terminal: Terminal, project: str, tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"content")
    terminal.run("upload", "-p", project, "-m", "m", "--create", tmp_path / "a.bin")
    assert "a.bin" in terminal.run("file", "delete", "-p", project, "-m", "m", "*", "--dry-run").out
    terminal.run("file", "delete", "-p", project, "-m", "m", "a.bin", code=2)  # no terminal to confirm in
    assert terminal.run("file", "list", "-p", project, "--count").out == "1\n"
    terminal.run("file", "delete", "-p", project, "-m", "m", "a.bin", "--yes")
    assert terminal.run("file", "list", "-p", project, "--count").out == "0\n"
    lost = [row for row in terminal.run("trash", "list", "--json").json()["items"] if project in row["location"]]
    assert [row["name"] for row in lost] == ["a.bin"]
    terminal.run("trash", "restore", lost[0]["id"])
    assert terminal.run("file", "list", "-p", project, "--count").out == "1\n"


def test_move_and_rename_touch_rows_only(terminal: Terminal, project: str, tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"moving")
    terminal.run("upload", "-p", project, "-m", "m", "--create", tmp_path / "a.bin")
    terminal.run("mission", "create", "-p", project, "n")
    before = terminal.run("file", "info", "-p", project, "-m", "m", "a.bin", "--json").json()["file"]
    assert "Would move 1" in terminal.run("move", "-p", project, "-m", "m", "*", "--to-mission", "n", "--dry-run").err
    terminal.run("move", "-p", project, "-m", "m", "*", "--to-mission", "n")
    terminal.run("rename", "sub/b.bin", "-p", project, "-m", "n", "-f", "a.bin")
    terminal.run("rename", "renamed", "-p", project, "-m", "n")
    after = terminal.run("file", "info", before["id"], "--json").json()["file"]
    assert (after["path"], after["mission"]["name"]) == ("sub/b.bin", "renamed")
    assert after["sha256"] == before["sha256"]
    other = f"{project}-other"
    terminal.run("project", "create", other)
    terminal.run("move", "-p", project, "-m", "renamed", "--to-project", other)
    moved = terminal.run("mission", "info", "renamed", "-p", other, "--json").json()
    assert moved["mission"]["project"]["name"] == other


def test_ambiguous_names_list_the_candidates(terminal: Terminal, project: str) -> None:
    other = f"{project}-2"
    terminal.run("project", "create", other)
    terminal.run("mission", "create", "twin", "-p", project)
    terminal.run("mission", "create", "Twin", "-p", other)
    refused = terminal.run("mission", "info", "twin", code=5).err
    assert f"{project}/twin" in refused
    assert f"{other}/Twin" in refused
    terminal.run("mission", "info", "TWIN", "-p", project)
    terminal.run("mission", "create", "tWIN", "-p", project, code=5)
    terminal.run("mission", "info", "nope", "-p", project, code=3)


def test_json_stands_alone_on_stdout(terminal: Terminal, project: str, tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"one more")
    upload = ["upload", "-p", project, "-m", "m", "--create", tmp_path / "a.bin", "--json"]
    assert terminal.run(*upload, "--dry-run").json()["items"][0]["path"] == "a.bin"
    assert set(terminal.run(*upload).json()["items"][0]) == {
        "path",
        "local",
        "size_bytes",
        "outcome",
        "moved_bytes",
        "file_id",
        "sha256",
        "error",
    }
    commands: list[list[object]] = [
        ["project", "list"],
        ["project", "info", project],
        ["mission", "list", "-p", project],
        ["mission", "info", "m", "-p", project],
        ["mission", "template", project],
        ["file", "list", "-p", project],
        ["file", "info", "a.bin", "-p", project, "-m", "m"],
        ["search", "--show", "topics", "-p", project],
        ["search", "--show", "missions", "-p", project],
        ["stats"],
        ["trash", "list"],
        ["audit", "-p", project],
        ["endpoint"],
        ["endpoint", "list"],
        ["verify", "-p", project, "-m", "m", tmp_path / "a.bin"],
        ["verify", "-p", project, "-m", "m", "--remote"],
        ["download", "-p", project, "--dest", tmp_path / "d"],
    ]
    for command in commands:
        assert isinstance(terminal.run(*command, "--json").json(), dict), command


@pytest.mark.slow
def test_endpoint_shows_which_endpoint_is_used_and_why(terminal: Terminal) -> None:
    assert terminal.run("endpoint", "--json").json()["source"] == "local"
    terminal.run("endpoint", "add", "lab", "http://127.0.0.1:9/", stdin="secret\n")
    saved = terminal.home / "config" / "kleinkram" / "endpoints.json"
    assert saved.stat().st_mode & 0o777 == 0o600
    assert json.loads(saved.read_text())["endpoints"]["lab"]["token"] == "secret"
    assert terminal.run("endpoint", "--json").json()["source"] == "chosen"
    unreachable = terminal.run("project", "list", code=7).err
    assert "http://127.0.0.1:9" in unreachable
    assert "secret" not in unreachable
    terminal.run("endpoint", "remove", "lab")
    assert terminal.run("endpoint", "--json").json()["name"] == "local"
    terminal.run("endpoint", "use", "lab", code=3)
    stranger = Terminal(terminal.home, {**terminal.environment, "KLEINKRAM_TOKEN": "wrong"})
    url = terminal.run("endpoint", "--json").json()["url"]
    stranger.environment["KLEINKRAM_URL"] = url
    refused = stranger.run("project", "list", code=4).err
    assert "Request id" in refused
