"""The upload plan for a set of paths."""

import os
import threading
import unicodedata
from pathlib import Path

import pytest

from kleinkram.client.errors import InvalidInput, NameUnusable, NotAFile, PathsCollide, StillRecording
from kleinkram.client.transfer import plan_upload

LONG_AGO = (1_700_000_000, 1_700_000_000)


def old_file(path: Path, content: bytes = b"x") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    os.utime(path, LONG_AGO)
    return path


@pytest.fixture
def day(tmp_path: Path) -> Path:
    old_file(tmp_path / "day" / "cam.mcap")
    old_file(tmp_path / "day" / "bag" / "metadata.yaml")
    return tmp_path / "day"


@pytest.mark.parametrize(
    ("argument", "planned"),
    [
        ("{day}", ["day/bag/metadata.yaml", "day/cam.mcap"]),
        ("{day}/", ["bag/metadata.yaml", "cam.mcap"]),
        ("{day}/.", ["bag/metadata.yaml", "cam.mcap"]),
        ("{day}/bag/..", ["bag/metadata.yaml", "cam.mcap"]),
        ("{day}/bag", ["bag/metadata.yaml"]),
        ("{day}/bag/metadata.yaml", ["metadata.yaml"]),
    ],
)
def test_a_folder_keeps_its_tree_and_a_slash_selects_its_contents(day: Path, argument: str, planned: list[str]) -> None:
    assert [file.path for file in plan_upload([argument.format(day=day)]).files] == planned


def test_a_dot_selects_the_contents_of_this_folder(day: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(day)
    assert [file.path for file in plan_upload(["."]).files] == ["bag/metadata.yaml", "cam.mcap"]


def test_a_file_passed_twice_is_uploaded_once(day: Path) -> None:
    assert len(plan_upload([day / "cam.mcap", day / "cam.mcap"]).files) == 1


@pytest.mark.parametrize("other", ["cam.mcap", "CAM.mcap"])
def test_files_with_the_same_destination_are_all_refused_and_named(day: Path, tmp_path: Path, other: str) -> None:
    second, third = old_file(tmp_path / "other" / other), old_file(tmp_path / "other" / "third.mcap")
    plan = plan_upload([day / "cam.mcap", second, third])
    assert [file.path for file in plan.files] == ["third.mcap"]
    (collision,) = plan.left_out
    assert isinstance(collision, PathsCollide)
    assert all(str(path) in str(collision) for path in (day / "cam.mcap", second))


def test_names_that_look_the_same_are_shown_with_code_points(tmp_path: Path) -> None:
    for form in ("NFC", "NFD"):
        old_file(tmp_path / "names" / unicodedata.normalize(form, "caf\u00e9.txt"))
    old_file(tmp_path / "names" / "other.txt")
    plan = plan_upload([tmp_path / "names"])
    assert [file.path for file in plan.files] == ["names/other.txt"]
    (collision,) = plan.left_out
    assert all(text in str(collision) for text in ("caf\\xe9.txt", "cafe\\u0301.txt"))


def test_special_files_are_named_and_skipped(day: Path) -> None:
    os.mkfifo(day / "pipe")
    (day / "loop").symlink_to(day)
    (day / "dead").symlink_to(day / "nothing")
    plan = plan_upload([f"{day}/"])
    assert [file.path for file in plan.files] == ["bag/metadata.yaml", "cam.mcap"]
    assert sorted(type(error).__name__ for error in plan.left_out) == ["FileUnreadable", "NotAFile", "NotAFile"]
    assert any("named pipe" in str(error) for error in plan.left_out if isinstance(error, NotAFile))


def test_links_to_files_and_links_passed_as_arguments_are_followed(day: Path, tmp_path: Path) -> None:
    (day / "link.mcap").symlink_to(day / "cam.mcap")
    (tmp_path / "shortcut").symlink_to(day)
    plan = plan_upload([tmp_path / "shortcut"])
    assert "shortcut/link.mcap" in [file.path for file in plan.files]


@pytest.mark.parametrize("name", [b"bad\xff.bin", b"new\nline", b"back\\slash", b"x" * 251 + b".bin"])
def test_files_with_invalid_names_are_reported_and_left_out(day: Path, name: bytes) -> None:
    too_long = len(name) == 255
    (day / os.fsdecode(name)).write_bytes(b"x")
    plan = plan_upload([f"{day}/"], include_active=True)
    refused = [error for error in plan.left_out if isinstance(error, NameUnusable)]
    assert len(refused) == (0 if too_long else 1)
    assert all("\n" not in str(error) for error in refused)


def test_a_missing_path_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="nowhere"):
        plan_upload([tmp_path / "nowhere"])


def test_files_being_written_are_skipped_by_default(day: Path) -> None:
    old_file(day / "run.mcap.active")
    plan = plan_upload([f"{day}/"])
    assert [type(error) for error in plan.left_out] == [StillRecording]
    assert len(plan_upload([f"{day}/"], include_active=True).files) == 3


def test_a_growing_file_is_left_out_and_a_fresh_one_is_not(day: Path) -> None:
    growing = day / "growing.mcap"
    growing.write_bytes(b"begin")
    (day / "fresh.mcap").write_bytes(b"done")
    ended = threading.Event()

    def record() -> None:
        with growing.open("ab", buffering=0) as out:
            while not ended.wait(0.05):
                out.write(b"more")

    recorder = threading.Thread(target=record)
    recorder.start()
    try:
        plan = plan_upload([f"{day}/"])
    finally:
        ended.set()
        recorder.join()
    assert [file.path for file in plan.files] == ["bag/metadata.yaml", "cam.mcap", "fresh.mcap"]
    assert [error.path for error in plan.left_out if isinstance(error, StillRecording)] == [str(growing)]
