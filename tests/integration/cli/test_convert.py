"""`klein convert`: one output for each recording, what changes is said, and nothing is replaced."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Reader as BagReader

from kleinkram.cli import main as entry
from kleinkram.recordings import Recording
from kleinkram.recordings.sample import generate_bag, generate_db3, generate_mcap
from tests.recording_files.whole_mcap import read_whole_mcap


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a bag, an MCAP, a database and a truncated bag."""
    folder = tmp_path_factory.mktemp("drives")
    (folder / "nuc").mkdir()
    generate_bag(folder / "nuc" / "drive.bag", size_bytes=1_000_000, duration_s=5)
    generate_mcap(folder / "drive.mcap", size_bytes=1_000_000, duration_s=5)
    generate_db3(folder / "ros2", size_bytes=1_000_000, duration_s=5)
    data = (folder / "nuc" / "drive.bag").read_bytes()
    (folder / "cut.bag").write_bytes(data[: len(data) * 8 // 10])
    return folder


class Convert:
    """Runs `klein convert` as a terminal would."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        """Return exit code, stdout and stderr."""
        self._monkeypatch.setattr("sys.argv", ["klein", "convert", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            entry.main()
        printed = self._capsys.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    def json(self, *arguments: object) -> tuple[int, list[dict[str, Any]]]:
        code, out, _ = self(*arguments, "--json")
        return code, json.loads(out)["items"]


@pytest.fixture
def convert(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Convert:
    return Convert(monkeypatch, capsys)


def test_a_folder_becomes_mcaps_with_ros_2_messages(drives: Path, tmp_path: Path, convert: Convert) -> None:
    code, items = convert.json(drives, "-o", tmp_path)
    assert (code, [item["error"] for item in items]) == (0, [None] * 4)
    made = {
        item["recording"]: (item["status"], item["path"] and Path(item["path"]).relative_to(tmp_path).as_posix())
        for item in items
    }
    assert made == {
        "cut.bag": ("converted", "cut.mcap"),
        "drive.mcap": ("unchanged", None),
        "nuc/drive.bag": ("converted", "nuc/drive.mcap"),
        "ros2": ("converted", "ros2.mcap"),
    }
    lost = {item["recording"]: bool(item["losses"]) for item in items}
    assert lost == {"cut.bag": True, "drive.mcap": False, "nuc/drive.bag": False, "ros2": False}
    for item in items:
        if item["path"]:
            whole = read_whole_mcap(Path(item["path"]))
            assert {channel.message_encoding for channel in whole.channels} == {"cdr"}
            assert (len(whole.messages), item["output_bytes"]) == (
                item["message_count"],
                Path(item["path"]).stat().st_size,
            )
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["cut.mcap", "drive.mcap", "nuc", "ros2.mcap"]


def test_ros_1_messages_can_stay(drives: Path, tmp_path: Path, convert: Convert) -> None:
    code, items = convert.json(
        drives / "nuc" / "drive.bag", "--keep-ros1", "--compression", "lz4", "--level", "9", "-o", tmp_path
    )
    assert (code, items[0]["status"]) == (0, "converted")
    whole = read_whole_mcap(tmp_path / "drive.mcap")
    assert whole.compressions == {"lz4"}
    with Recording.open(drives / "nuc" / "drive.bag") as recording:
        assert [one[4] for one in whole.messages] == [message.data for message in recording.raw_messages()]


def test_databases_and_mcaps_become_bags(drives: Path, tmp_path: Path, convert: Convert) -> None:
    code, items = convert.json(
        drives / "ros2", drives / "drive.mcap", "--to", "bag", "--compression", "bz2", "-o", tmp_path
    )
    assert code == 0
    assert [Path(item["path"]).name for item in items] == ["ros2.bag", "drive.bag"]
    for item in items:
        with BagReader(item["path"]) as reader:
            assert sum(1 for _ in reader.messages()) == item["message_count"] > 100


def test_a_whole_bag_needs_no_conversion(drives: Path, tmp_path: Path, convert: Convert) -> None:
    code, out, err = convert(drives / "nuc" / "drive.bag", "--to", "bag", "-o", tmp_path)
    assert (code, out) == (0, "")
    assert err == "drive.bag: nothing to do, it is already as wanted.\n"
    assert not [*tmp_path.iterdir()]


def test_damage_that_no_index_shows_is_repaired(drives: Path, tmp_path: Path, convert: Convert) -> None:
    data = bytearray((drives / "drive.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "flipped.mcap").write_bytes(data)
    code, out, err = convert(tmp_path / "flipped.mcap", "-o", tmp_path / "out")
    assert code == 0
    assert "out/flipped.mcap" in out
    assert err.startswith("Lost: flipped.mcap: ")
    assert read_whole_mcap(tmp_path / "out" / "flipped.mcap").messages


def test_a_dry_run_says_what_would_be_made_and_why(drives: Path, tmp_path: Path, convert: Convert) -> None:
    code, items = convert.json(drives, "-o", tmp_path, "--dry-run")
    assert (code, [*tmp_path.iterdir()]) == (0, [])
    reasons = {item["recording"]: item["reasons"] for item in items}
    assert reasons["drive.mcap"] == []
    assert reasons["nuc/drive.bag"] == ["rosbag1 becomes an MCAP", "ROS 1 messages become ROS 2 messages"]
    assert reasons["ros2"] == ["db3 becomes an MCAP"]
    assert any(reason.startswith("it is repaired: ") for reason in reasons["cut.bag"])
    estimated = {item["recording"]: item["estimated_bytes"] for item in items}
    convert(drives, "-o", tmp_path)
    for name, path in (("nuc/drive.bag", "nuc/drive.mcap"), ("ros2", "ros2.mcap")):
        assert 0.5 < estimated[name] / (tmp_path / path).stat().st_size < 2


@pytest.mark.parametrize("arguments", [["--compression", "lz4"], ["--level", "19"]])
def test_recompression_is_a_reason(drives: Path, tmp_path: Path, convert: Convert, arguments: list[str]) -> None:
    _, items = convert.json(drives / "drive.mcap", *arguments, "-o", tmp_path, "--dry-run")
    (reason,) = items[0]["reasons"]
    assert reason in ("compression changes from zstd to lz4", "it is compressed with level 19")
    code, items = convert.json(drives / "drive.mcap", *arguments, "-o", tmp_path)
    assert (code, items[0]["status"]) == (0, "converted")


def test_output_names_the_file_of_one_recording(drives: Path, tmp_path: Path, convert: Convert) -> None:
    code, items = convert.json(drives / "nuc" / "drive.bag", "-o", tmp_path / "new" / "walk.mcap")
    assert (code, items[0]["path"]) == (0, str(tmp_path / "new" / "walk.mcap"))
    assert read_whole_mcap(tmp_path / "new" / "walk.mcap").messages
    for sources, name in (([drives], "all.mcap"), ([drives / "drive.mcap"], "drive.bag")):
        code, _, err = convert(*sources, "-o", tmp_path / name)
        assert code == 2
        assert "it is a folder, or, for one recording, a file with the extension .mcap, not" in err
        assert not (tmp_path / name).exists()


def test_what_exists_is_not_replaced_and_nothing_is_written(drives: Path, tmp_path: Path, convert: Convert) -> None:
    (tmp_path / "ros2.mcap").write_text("mine")
    code, out, err = convert(drives, "-o", tmp_path)
    assert (code, out) == (11, "")
    assert "ros2.mcap' was not written: there is such a file or folder, and it is not replaced" in err
    assert [path.name for path in tmp_path.iterdir()] == ["ros2.mcap"]
    assert (tmp_path / "ros2.mcap").read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--to", "db3"], "--to is mcap or bag, not 'db3'"),
        (["--compression", "gz"], "--compression is zstd, lz4, none, not 'gz'"),
        (["--to", "bag", "--compression", "zstd"], "--compression is lz4, bz2, none, not 'zstd'"),
        (["--level", "23"], "zstd has levels 1 to 22, not 23"),
        (["--to", "bag", "--level", "3"], "--level is for MCAPs, not for bags"),
        (["--to", "bag", "--keep-ros1"], "--keep-ros1 is for MCAPs, not for bags"),
    ],
)
def test_options_that_do_not_exist_are_refused(
    drives: Path, tmp_path: Path, convert: Convert, arguments: list[str], reason: str
) -> None:
    code, _, err = convert(drives, *arguments, "-o", tmp_path)
    assert (code, err) == (2, f"Error: The command is invalid: {reason}.\n")


def test_a_missing_source_is_refused(tmp_path: Path, convert: Convert) -> None:
    code, _, err = convert(tmp_path / "no.bag")
    assert (code, "there is no such file or folder" in err) == (8, True)


def test_one_bad_recording_does_not_stop_the_others(drives: Path, tmp_path: Path, convert: Convert) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "bad.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    shutil.copyfile(drives / "nuc" / "drive.bag", tmp_path / "in" / "good.bag")
    code, out, err = convert(tmp_path / "in", "-o", tmp_path / "out")
    assert code == 8
    assert err.startswith("Not converted: ")
    assert "good.bag" in out
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["good.mcap"]


def test_recordings_with_one_name_get_names_of_their_own(drives: Path, tmp_path: Path, convert: Convert) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        shutil.copyfile(drives / "nuc" / "drive.bag", tmp_path / folder / "drive.bag")
    code, items = convert.json(tmp_path / "a" / "drive.bag", tmp_path / "b" / "drive.bag", "-o", tmp_path / "out")
    assert code == 0
    paths = [Path(item["path"]) for item in items]
    assert len({*paths}) == 2
    assert all(path.is_relative_to(tmp_path / "out") for path in paths)
