"""Folders that hold backups, or something else: what is not ours stays, what is ours outlives a power cut."""

import asyncio
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
    asyncio.run(forget(str(tmp_path), None, keep=1))
    assert not half.exists()
