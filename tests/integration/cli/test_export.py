"""`klein export` of local recordings: files, text for people, JSON for scripts, and the exit code."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from kleinkram.cli import main as entry
from kleinkram.recordings.sample import generate_bag, generate_mcap

pytestmark = pytest.mark.usefixtures("remembered_scenes")


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    """A folder with two recordings."""
    for name in ("front", "rear"):
        (tmp_path / "mission" / name).mkdir(parents=True)
    generate_mcap(tmp_path / "mission" / "front" / "drive.mcap", duration_s=2, size_bytes=2_000_000)
    generate_bag(tmp_path / "mission" / "rear" / "drive.bag", duration_s=2, size_bytes=2_000_000)
    return tmp_path / "mission"


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run `klein export` as a terminal would; return the exit code."""
    monkeypatch.setattr("sys.argv", ["klein", "export", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        entry.main()
    return int(ended.value.code or 0)


def test_a_folder_is_a_mission(
    mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tables"
    assert run(monkeypatch, mission, "--to", "parquet", "--topics", "/imu/*,/odom", "-o", out, "--json") == 0
    (item,) = json.loads(capsys.readouterr().out)["items"]
    assert (item["project"], item["mission"], item["folder"], item["error"]) == (None, None, str(out), None)
    assert {file["topic"] for file in item["files"]} == {"/imu/data", "/odom"}
    assert pq.read_table(out / "odom.parquet")["recording"].unique().to_pylist() == ["front/drive.mcap"]
    assert pq.read_table(out / "odom-2.parquet")["recording"].unique().to_pylist() == ["rear/drive.bag"]


def test_the_files_are_printed(
    mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "pictures"
    drive = mission / "front" / "drive.mcap"
    assert run(monkeypatch, drive, "--to", "images", "--rate", "2", "-o", out) == 0
    shown = capsys.readouterr().out
    assert "/camera/image/compressed" in shown
    assert str(out / "camera.image.compressed") in shown
    assert len([*(out / "camera.image.compressed").glob("*.jpg")]) == 4


def test_nothing_is_left_where_the_extra_is_missing(
    mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert run(monkeypatch, mission, "--to", "csv", "-o", tmp_path / "tables") == 8
    assert "this needs pyarrow: run `pip install 'open-kleinkram[reading]'`" in capsys.readouterr().err
    assert not (tmp_path / "tables").exists()


def test_a_dry_run_writes_nothing(
    mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, mission, "--to", "csv", "--topics", "/odom", "--dry-run", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["dry_run"]
    assert [(item["path"], item["recordings"]) for item in document["items"]] == [
        ("odom.csv", ["front/drive.mcap"]),
        ("odom-2.csv", ["rear/drive.bag"]),
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["mission"]


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--to", "csv"], 2, "specify the folder to write to: -o DIR"),
        (["--to", "csv", "-o", "out", "--rate", "2"], 2, "use --to images"),
        (["--to", "images", "-o", "out", "--rate", "0"], 2, "the rate of images must be above 0"),
        (["--to", "csv", "-o", "out", "--start", "yesterday"], 2, "'yesterday' is no time"),
        (["--to", "csv", "-o", "out", "--start", "+2s", "--end", "+1s"], 2, "The time range is invalid"),
        (["--to", "csv", "-o", "out", "--start", "2001-01-01"], 0, ""),
        (["--to", "csv", "-o", "out", "--end", "2001-01-01"], 3, "nothing was recorded"),
        (["--to", "csv", "-o", "out", "--topics", "/nothing"], 3, "there is no topic /nothing"),
        (["--to", "csv", "-o", "out", "--topics", "/no*"], 3, "No topic matches /no*"),
        (["--to", "csv", "-o", "."], 11, "there is such a file or folder"),
        (["--to", "csv", "-o", ".", "--continue"], 11, "there is no export in it"),
        (["--to", "xml", "-o", "out"], 2, "xml"),
    ],
)
def test_bad_input_is_one_sentence(
    mission: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    text: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, mission / "front" / "drive.mcap", *arguments) == code
    shown = capsys.readouterr().err
    assert text in shown
    assert "Traceback" not in shown
    assert (tmp_path / "out").exists() is (code == 0)


def test_missing_sources_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--to", "csv", "-o", tmp_path / "out") == 2
    assert "specify files or folders, or a mission with -m" in capsys.readouterr().err
    assert run(monkeypatch, tmp_path / "none.mcap", "--to", "csv", "-o", tmp_path / "out") == 8
    assert "there is no such file or folder" in capsys.readouterr().err


def test_a_file_that_is_no_recording_is_named(
    mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (mission / "notes.bag").write_text("not a recording")
    assert run(monkeypatch, mission, "--to", "csv", "--topics", "/odom", "-o", tmp_path / "out") == 0
    assert "Left out: notes.bag" in capsys.readouterr().err
    assert run(monkeypatch, mission / "notes.bag", "--to", "csv", "-o", tmp_path / "other") == 8


def test_an_interrupted_export_is_continued(
    mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_arguments: object) -> None:
        raise KeyboardInterrupt

    command = (mission, "--to", "csv", "--topics", "/odom", "-o", tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr("kleinkram.recordings.writing.export.write_csv", interrupt)
        assert run(monkeypatch, *command) == 130
    assert run(monkeypatch, *command) == 11
    assert run(monkeypatch, *command, "--continue") == 0
    assert (tmp_path / "out" / "odom.csv").exists()
