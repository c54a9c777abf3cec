"""Finds the recordings in local files and folders, to open each of them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from kleinkram.recordings.errors import NotARecording
from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME
from kleinkram.recordings.recording import Recording
from kleinkram.recordings.recording_groups import RecordingGroup, RecordingGroupKind, read_folder
from kleinkram.recordings.sources import FileSource


class LocalRecordingPath(NamedTuple):
    """A recording of local files: its name, and what opens it."""

    name: str
    open: Callable[[], Recording]


def find_recordings(paths: Iterable[str | os.PathLike[str]]) -> list[LocalRecordingPath]:
    """Return the recordings of files and folders, in the given order; of a folder, each in it and below it.

    A recording that is named twice is returned once. Names are those of files, or paths in their folder; where two
    would be the same, they are the whole paths.

    Raises:
        FileNotFoundError: a path does not exist.
        NotARecording: there is no recording in a folder.
    """
    by_place: dict[Path, tuple[Path, LocalRecordingPath]] = {}
    for path in map(Path, paths):
        for place, item in _recordings_in(path):
            by_place.setdefault(place.resolve(), (path, item))
    recordings = by_place.values()
    counts = Counter(item.name for _, item in recordings)
    return [
        item if counts[item.name] == 1 else item._replace(name=str(path / item.name if path.is_dir() else path))
        for path, item in recordings
    ]


def _recordings_in(path: Path) -> Iterator[tuple[Path, LocalRecordingPath]]:
    """Yield the file or folder of each recording, and what opens it."""
    if not path.exists():
        raise FileNotFoundError(f"{path}: there is no such file or folder")
    if not path.is_dir():
        is_metadata = path.name == METADATA_NAME
        place = path.resolve().parent if is_metadata else path
        yield place, LocalRecordingPath(place.name, partial(Recording.open, path))
        return
    groups = read_folder(path).groups
    if not groups:
        raise NotARecording(str(path), "there is no recording in it")
    for group in groups:
        name = path.resolve().name if group.name == "." else group.name
        yield path / group.name, LocalRecordingPath(name, _opener(path, group))


def _opener(folder: Path, group: RecordingGroup) -> Callable[[], Recording]:
    if group.kind is RecordingGroupKind.rosbag2 and group.metadata_path is not None:
        return partial(Recording.open, folder / group.metadata_path)
    if len(group.members) == 1:
        return partial(Recording.open, folder / group.members[0])
    return partial(Recording.open, _LocalFiles([folder / name for name in group.members]))


class _LocalFiles:
    """The files of a split recording."""

    def __init__(self, paths: Iterable[Path]) -> None:
        self._paths = [*paths]
        self._sources: list[FileSource] = []

    def sources(self) -> Sequence[FileSource]:
        """Open the files."""
        self._sources = [FileSource(path) for path in self._paths]
        return self._sources

    def close(self) -> None:
        """Close them."""
        for source in self._sources:
            source.close()
