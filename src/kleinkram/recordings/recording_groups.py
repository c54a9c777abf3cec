"""Groups files into recordings, by their names and by metadata.yaml.

* rosbag2: a folder with metadata.yaml and data files (.mcap, .db3, also .zstd) of one stem, such as `run_0.mcap`,
  `run_1.mcap`. With several stems, those of the folder's own name; if there are none, metadata.yaml is something else.
  A metadata.yaml that is known to be something else counts as none.
* split: `name_0.mcap`, `name_1.mcap` ... without metadata.yaml, if number 0 is there (else they are numbered
  recordings). A time at the end of a name is not such a number: `run_2026_01_17-10_00_00.mcap` is single.
* split, with the time of each file in its name: `0_name_2026_01_17-10_00_30.mcap`, `1_name_2026_01_17-10_01_30.mcap`
  ... of rosbag2 since Kilted, and for bags what `rosbag record --split` makes, `prefix_2024-05-01-10-00-00_0.bag`,
  `prefix_2024-05-01-10-05-00_1.bag` ...; a smaller number begins the next recording.
  Where the content of metadata.yaml is known, the files that it names come first and in its order; files of the same
  stem that it does not name follow them; a folder of which no file is there is a recording without members.
* single: every other recording file.
"""

from __future__ import annotations

import os
import re
import stat
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.formats.rosbag2.metadata import (
    MAX_TEXT,
    METADATA_NAME,
    Rosbag2Metadata,
    parse_rosbag2_metadata,
)

# `.active`: a bag whose recorder was killed, or is still at work.
_RECORDING = re.compile(r".*\.(bag|mcap|db3|svo2|ulg)(\.zstd?)?(\.active)?", re.IGNORECASE | re.DOTALL)
_ROSBAG2 = re.compile(r"(?P<stem>.+?)(_(?P<number>\d+))?(?P<suffix>\.(mcap|db3)(\.zstd?)?)", re.IGNORECASE | re.DOTALL)
_TIMED_ROSBAG2 = re.compile(
    r"(?P<folder>(.*/)?)(?P<number>\d+)_(?P<name>[^/]+)_(?P<time>\d{4}_\d\d_\d\d-\d\d_\d\d_\d\d)"
    r"(?P<suffix>\.(mcap|db3)(\.zstd?)?)",
    re.IGNORECASE | re.DOTALL,
)
_BAG = re.compile(
    r"(?P<prefix>.*)(?P<time>\d{4}-\d\d-\d\d-\d\d-\d\d-\d\d)_(?P<number>\d+)\.bag(\.active)?",
    re.IGNORECASE | re.DOTALL,
)
# A date and a time of day at the end of a name, with the usual separators or none.
_TIME_AT_END = re.compile(
    r"(?<!\d)\d{4}([-_.]?)(0[1-9]|1[0-2])\1(0[1-9]|[12]\d|3[01])[-_T.]?"
    r"([01]\d|2[0-3])([-_.:]?)[0-5]\d(\5[0-5]\d)?",
    re.IGNORECASE,
)


class RecordingGroupKind(str, Enum):
    """Properties by which files belong to one recording."""

    single = "single"
    split_set = "split"
    rosbag2 = "rosbag2"


@dataclass(frozen=True)
class RecordingGroup:
    """The files of one recording. Name and kind together are unique.

    Attributes:
        name: the path of a single file; the path of a rosbag2 folder ("." for the top); the common path of a split
            set, "run.mcap" for `run_0.mcap` and so on.
        members: paths of its data files, in the order of recording.
        metadata_path: the metadata.yaml of a rosbag2 folder; not among the members.
    """

    name: str
    kind: RecordingGroupKind
    members: tuple[str, ...]
    metadata_path: str | None = None


def is_recording_name(path: str) -> bool:
    """Return whether a file has the name of a recording."""
    return _RECORDING.fullmatch(path) is not None


def group(paths: Iterable[str], metadata_files: Mapping[str, Rosbag2Metadata] | None = None) -> list[RecordingGroup]:
    """Group relative POSIX paths into recordings, sorted by name. Other paths belong to no group.

    `metadata_files`: the content of each metadata.yaml among `paths`, where it could be read.
    """
    folders: dict[str, list[str]] = defaultdict(list)
    metadata: dict[str, str] = {}
    for path in sorted(set(paths)):
        folder, _, name = path.rpartition("/")
        if is_recording_name(name):
            folders[folder].append(path)
        elif name == METADATA_NAME:
            metadata[folder] = path
    groups: list[RecordingGroup] = []
    for folder in folders.keys() | metadata.keys():
        members, metadata_path = folders[folder], metadata.get(folder)
        folder_metadata = (metadata_files or {}).get(metadata_path or "")
        if metadata_path is not None and not (folder_metadata is not None and folder_metadata.is_other):
            own = _members(folder, members, folder_metadata)
            if own or (folder_metadata is not None and folder_metadata.files):
                kind = RecordingGroupKind.rosbag2
                groups.append(RecordingGroup(folder or ".", kind, tuple(own), metadata_path))
                members = sorted(set(members) - set(own))
        groups += _group_by_name(members)
    return sorted(groups, key=lambda recording: (recording.name, recording.kind.value))


class _DataFile(NamedTuple):
    """A rosbag2 data file, with the parts of its name.

    `stem`: without number, time and suffix, that of all files of one recording. `number`: 0 where the name has none.
    """

    path: str
    stem: str
    number: int
    time: str
    suffix: str


def _parse_name(path: str) -> _DataFile | None:
    """Parse the name of a rosbag2 data file; None for other names."""
    if timed := _TIMED_ROSBAG2.fullmatch(path):
        return _DataFile(path, timed["folder"] + timed["name"], int(timed["number"]), timed["time"], timed["suffix"])
    plain = _ROSBAG2.fullmatch(path)
    if plain is None:
        return None
    numbered = f"{plain['stem']}_{plain['number']}"
    if plain["number"] and any(match.end() == len(numbered) for match in _TIME_AT_END.finditer(numbered)):
        return _DataFile(path, numbered, 0, "", plain["suffix"])
    return _DataFile(path, plain["stem"], int(plain["number"] or 0), "", plain["suffix"])


def _members(folder: str, paths: list[str], metadata: Rosbag2Metadata | None) -> list[str]:
    """Return the data files of a folder's metadata.yaml."""
    by_stem: dict[str, list[_DataFile]] = defaultdict(list)
    for path in paths:
        if (file := _parse_name(path)) is not None:
            by_stem[file.stem].append(file)
    named = {PurePosixPath(path).name: number for number, path in enumerate(metadata.files)} if metadata else {}
    here = sorted((named[name], path) for path in paths if (name := PurePosixPath(path).name) in named)
    if not here:
        named_alike = f"{folder}/{PurePosixPath(folder).name}"
        stem = next(iter(by_stem)) if len(by_stem) == 1 else named_alike
        return [file.path for file in _in_order(by_stem.get(stem, ()))]
    expected = [path for _, path in here]
    are_expected = set(expected)
    stems = sorted({file.stem for path in expected if (file := _parse_name(path)) is not None})
    unlisted = [file.path for stem in stems for file in _in_order(by_stem[stem]) if file.path not in are_expected]
    return [*expected, *unlisted]


def _in_order(files: Iterable[_DataFile]) -> list[_DataFile]:
    return sorted(files, key=lambda file: (file.number, file.time, file.path))


# When a file was begun, its number in the recording, and its path.
_Timed = tuple[str, int, str]


def _group_by_name(paths: Iterable[str]) -> list[RecordingGroup]:
    sets: dict[str, list[_DataFile]] = defaultdict(list)
    timed: dict[str, list[_Timed]] = defaultdict(list)
    groups: list[RecordingGroup] = []
    for path in paths:
        file, bag = _parse_name(path), _BAG.fullmatch(path)
        if file is not None and file.time:
            timed[file.stem + file.suffix].append((file.time, file.number, path))
        elif file is not None:
            sets[file.stem + file.suffix].append(file)
        elif bag is not None:
            timed[bag["prefix"]].append((bag["time"], int(bag["number"]), path))
        else:
            groups.append(_single(path))
    for name, files in sets.items():
        files = _in_order(files)
        if len(files) > 1 and files[0].number == 0:
            groups.append(RecordingGroup(name, RecordingGroupKind.split_set, tuple(file.path for file in files)))
        else:
            groups += [_single(file.path) for file in files]
    return groups + _group_timed(timed.values())


def _group_timed(sets: Iterable[list[_Timed]]) -> list[RecordingGroup]:
    """Split the files of each set, by time, where the number does not grow."""
    recordings: list[list[str]] = []
    for files in sets:
        previous: int | None = None
        for _time, number, path in sorted(files):
            if previous is None or number <= previous:
                recordings.append([])
            recordings[-1].append(path)
            previous = number
    return [
        RecordingGroup(paths[0], RecordingGroupKind.split_set, tuple(paths)) if len(paths) > 1 else _single(paths[0])
        for paths in recordings
    ]


def _single(path: str) -> RecordingGroup:
    return RecordingGroup(path, RecordingGroupKind.single, (path,))


@dataclass(frozen=True)
class UnreadableFolder:
    """A folder that cannot be listed, and why."""

    path: Path
    reason: str


@dataclass(frozen=True)
class FolderRecordings:
    """The recordings in a folder and below it; paths are relative to the folder.

    `metadata`: without those that are damaged. `unreadable_files`: links to nothing, and a metadata.yaml without
    permission; data files are not opened.
    """

    groups: tuple[RecordingGroup, ...]
    metadata: Mapping[str, Rosbag2Metadata]
    unreadable_files: Mapping[str, SourceError]
    unreadable_folders: tuple[UnreadableFolder, ...]

    def metadata_of(self, recording: RecordingGroup) -> Rosbag2Metadata | None:
        """Return the metadata of a recording; None if it has none, or a damaged one."""
        return self.metadata.get(recording.metadata_path or "")


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
    recordings = _group_names(folder, names)
    return replace(
        recordings,
        unreadable_files={**unreadable_files, **recordings.unreadable_files},
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
    """Return the recording of a metadata.yaml; None if it belongs to none."""
    names = [file.name for file in path.parent.iterdir() if _why_no_file(file) is None]
    recordings = _group_names(path.parent, names)
    if error := recordings.unreadable_files.get(path.name):
        raise error
    own = next((recording for recording in recordings.groups if recording.metadata_path == path.name), None)
    return None if own is None else (recordings, own)


def _group_names(folder: Path, names: list[str]) -> FolderRecordings:
    metadata: dict[str, Rosbag2Metadata] = {}
    unreadable: dict[str, SourceError] = {}
    for name in names:
        if name.rpartition("/")[2] != METADATA_NAME:
            continue
        path = folder / name
        try:
            with path.open(encoding="utf-8", errors="replace") as file:
                parsed = parse_rosbag2_metadata(file.read(MAX_TEXT + 1))
        except OSError as error:
            unreadable[name] = SourceError(f"{path}: cannot be read: {error.strerror}")
            continue
        if parsed is not None:
            metadata[name] = parsed
    groups = group((name for name in names if name not in unreadable), metadata)
    return FolderRecordings(tuple(groups), metadata, unreadable, ())
