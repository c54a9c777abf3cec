"""`klein inspect`: text for people, JSON for scripts, and the exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kleinkram.cli import main as entry
from kleinkram.cli.options import read_text
from kleinkram.cli.recordings import show
from kleinkram.recordings import Content, Lost, Problem, RecordingFormat, RecordingSummary
from kleinkram.recordings.inspect import Inspection, InspectionKind
from kleinkram.recordings.sample import SampleFormat, generate_mission


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    generate_mission(tmp_path, duration_s=1, formats=[SampleFormat.mcap])
    return tmp_path / "drive.mcap"


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run `klein inspect` as a terminal would; returns the exit code."""
    monkeypatch.setattr("sys.argv", ["klein", "inspect", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        entry.main()
    return int(ended.value.code or 0)


def test_inspect_prints_topics_as_text(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, drive) == 0
    shown = capsys.readouterr().out
    assert "indexed (complete)" in shown
    assert "/imu" in shown
    assert run(monkeypatch, "--deep", drive) == 0
    assert "every byte checked" in capsys.readouterr().out


def test_inspecting_broken_files_exits_with_0(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drive.write_bytes(drive.read_bytes()[:-2000])
    empty = drive.with_name("empty.bag")
    empty.write_bytes(b"")
    assert run(monkeypatch, "--json", "--deep", drive, empty) == 0
    cut, nothing = json.loads(capsys.readouterr().out)["items"]
    assert (cut["content"], cut["depth"], nothing["content"]) == ("recovered", "scan", "broken")
    assert cut["message_count"] > 0
    assert cut["reason"]


def test_a_missing_path_is_a_usage_error(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, drive, "/no/such/file.bag") == 2
    items = capsys.readouterr()
    assert "/no/such/file.bag" in items.err
    assert items.out == ""


def test_a_folder_without_recordings_prints_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, tmp_path) == 0
    assert "no recordings" in capsys.readouterr().err


def test_losses_and_problems_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    summary = RecordingSummary(
        RecordingFormat.rosbag2_db3,
        Content.recovered,
        "the file is cut",
        message_count=7,
        problems=(Problem("topic-undefined", "/a\x1b[31m", "told\x07"),),
        lost=Lost(2048, 1, None),
    )
    show(Inspection("a.db3", InspectionKind.file, ("a.db3",), summary))
    shown = capsys.readouterr().out
    assert "an unknown number of messages, 1 page, 2.0 kB" in shown
    assert "Warnings:" in shown
    assert "\x1b" not in shown
    assert "\x07" not in shown


def test_a_text_from_a_file_is_read_unchanged(tmp_path: Path) -> None:
    text = "\ufeffcountry: CH\r\nserial: 8\r\n"
    (tmp_path / "mission.yaml").write_bytes(text.encode())
    assert read_text(tmp_path / "mission.yaml") == text


def test_unreadable_files_are_reported_and_others_shown(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (drive.parent / "gone.mcap").symlink_to(drive.parent / "nowhere")
    assert run(monkeypatch, drive.parent) == 8
    items = capsys.readouterr()
    assert "indexed (complete)" in items.out
    assert "gone.mcap: cannot be read" in items.err
    assert run(monkeypatch, "--json", drive.parent) == 8
    shown = {Path(row["path"]).name: row["content"] for row in json.loads(capsys.readouterr().out)["items"]}
    assert shown == {"drive.mcap": "indexed", "gone.mcap": "error"}
