"""Folders that hold backups, or something else: what is not ours stays, what is ours outlives a power cut."""

import asyncio
import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from kleinkram.server.backup.creating import Making, create
from kleinkram.server.backup.failing import InTheWay, NothingThere
from kleinkram.server.backup.forgetting import forget
from kleinkram.server.backup.repository import make_repository
from kleinkram.server.backup.shelf import FolderShelf
from kleinkram.server.settings import Settings


def _create(place: Path) -> None:
    making = Making(str(place), sealed=False, passphrase=None, bytes_per_s=None, at_once=1, quiet=True)
    asyncio.run(create(Settings.model_construct(), making))


def _make(place: Path) -> FolderShelf:
    shelf = FolderShelf(place)
    asyncio.run(make_repository(shelf, None, sealed=False))
    return shelf


@pytest.mark.parametrize("path", ["unfinished/thesis.tex", "lockers.csv", "data/field-day.bag"])
def test_somebody_elses_folder_is_left_as_it_is(tmp_path: Path, path: str) -> None:
    theirs = tmp_path / path
    theirs.parent.mkdir(exist_ok=True)
    theirs.write_text("the only copy")
    with pytest.raises(InTheWay, match=path):
        _create(tmp_path)
    with pytest.raises(NothingThere):
        asyncio.run(forget(str(tmp_path), None, keep=1))
    assert theirs.read_text() == "the only copy"
    assert not (tmp_path / "klein-backup.json").exists()


def test_what_was_being_written_when_a_run_was_killed_goes(tmp_path: Path) -> None:
    half = tmp_path / "unfinished" / f"{7:032x}"
    half.parent.mkdir()
    half.write_text("half")  # killed at its very first file
    _make(tmp_path)
    (half.parent / "folder").mkdir()
    asyncio.run(forget(str(tmp_path), None, keep=1))
    assert [entry.name for entry in half.parent.iterdir()] == ["folder"]


def test_what_a_killed_run_wrote_is_on_the_disk_before_a_backup_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asyncio.run(_make(tmp_path).put("data/ab/abc", _once(b"bytes"), 5))  # and then it was killed
    synced: set[Path] = set()
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.add(Path(f"/proc/self/fd/{descriptor}").readlink()))

    async def go_on() -> None:
        shelf = FolderShelf(tmp_path)
        assert [item.path async for item in shelf.listed("data/")] == ["data/ab/abc"]
        await shelf.settle()

    asyncio.run(go_on())
    assert synced >= {tmp_path, tmp_path / "data", tmp_path / "data" / "ab"}


def test_a_file_that_goes_meanwhile_hides_no_other(tmp_path: Path) -> None:
    for number in range(9):
        (tmp_path / f"{number}").write_bytes(b"bytes")
        (tmp_path / f"{number}-gone").symlink_to("nowhere")  # as a listed name that is there no more

    async def listed() -> list[str]:
        return [item.path async for item in FolderShelf(tmp_path).listed("")]

    assert asyncio.run(listed()) == [f"{number}" for number in range(9)]


async def _once(body: bytes) -> AsyncIterator[bytes]:
    yield body
