"""Folders on this machine: which of their files make which recordings, and what of them cannot be read."""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.grouping import METADATA_NAME, RecordingGroup, group, is_recording_name
from kleinkram.recordings.rosbag2.metadata import MAX_TEXT, Rosbag2Metadata, parse_rosbag2_metadata


@dataclass(frozen=True)
class UnreadableFolder:
    """A folder below the one that was read, and why its files are not known."""

    path: Path
    reason: str


@dataclass(frozen=True)
class FolderRecordings:
    """The recordings in a folder and below it; paths in it are relative to the folder.

    Attributes:
        groups: the files of each recording.
        metadata: what each metadata.yaml says; without those that are damaged.
        unreadable_files: what is no readable file though its name is that of one, and why: links to nothing, a
            metadata.yaml without permission. Without that, recordings are grouped by the names of their files. Data
            files are not opened here.
        unreadable_folders: folders that cannot be listed.
    """

    groups: tuple[RecordingGroup, ...]
    metadata: Mapping[str, Rosbag2Metadata]
    unreadable_files: Mapping[str, SourceError]
    unreadable_folders: tuple[UnreadableFolder, ...]

    def metadata_of(self, found: RecordingGroup) -> Rosbag2Metadata | None:
        """Return what the metadata.yaml of a recording says; None where it has none, or a damaged one."""
        return self.metadata.get(found.metadata_path or "")


def read_folder(folder: Path) -> FolderRecordings:
    """Find the recordings in a folder and below it. Links to folders are not followed."""
    names: list[str] = []
    unreadable_folders: list[UnreadableFolder] = []
    unreadable_files: dict[str, SourceError] = {}

    def note(error: OSError) -> None:
        unreadable_folders.append(UnreadableFolder(Path(error.filename), error.strerror or str(error)))

    for here, _, files in os.walk(folder, onerror=note):
        for path in (Path(here) / name for name in files):
            name = path.relative_to(folder).as_posix()
            reason = _why_no_file(path)
            if reason is None:
                names.append(name)
            elif is_recording_name(name) or path.name == METADATA_NAME:
                unreadable_files[name] = SourceError(f"{path}: cannot be read: {reason}")
    found = _group_names(folder, names)
    return replace(
        found,
        unreadable_files={**unreadable_files, **found.unreadable_files},
        unreadable_folders=tuple(unreadable_folders),
    )


def _why_no_file(path: Path) -> str | None:
    try:
        return None if stat.S_ISREG(path.stat().st_mode) else "it is not a regular file"
    except FileNotFoundError:
        return "it is a link to nothing"
    except OSError as error:
        return error.strerror or str(error)


def recording_of_metadata(path: Path) -> tuple[FolderRecordings, RecordingGroup] | None:
    """Find the recording that a metadata.yaml is about, among the files beside it; None where it is about none.

    Raises:
        SourceError: it cannot be read.
    """
    names = [file.name for file in path.parent.iterdir() if _why_no_file(file) is None]
    found = _group_names(path.parent, names)
    if error := found.unreadable_files.get(path.name):
        raise error
    own = next((each for each in found.groups if each.metadata_path == path.name), None)
    return None if own is None else (found, own)


def _group_names(folder: Path, names: list[str]) -> FolderRecordings:
    metadata: dict[str, Rosbag2Metadata] = {}
    unreadable: dict[str, SourceError] = {}
    for name in names:
        if name.rpartition("/")[2] != METADATA_NAME:
            continue
        try:
            if (stated := _read_metadata(folder / name)) is not None:
                metadata[name] = stated
        except SourceError as error:
            unreadable[name] = error
    groups = group((name for name in names if name not in unreadable), metadata)
    return FolderRecordings(tuple(groups), metadata, unreadable, ())


def _read_metadata(path: Path) -> Rosbag2Metadata | None:
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return parse_rosbag2_metadata(file.read(MAX_TEXT + 1))
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
