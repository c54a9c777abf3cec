"""Which files make one recording, by their names only.

* rosbag2: a folder with metadata.yaml and data files (.mcap, .db3, also .zstd) of one stem, such as `run_0.mcap`,
  `run_1.mcap`. With several stems, those of the folder's own name; if there are none, metadata.yaml is something else.
* split: `name_0.mcap`, `name_1.mcap` ... without metadata.yaml, if number 0 is there (else they are numbered
  recordings); for bags what `rosbag record --split` makes, `prefix_2024-05-01-10-00-00_0.bag`,
  `prefix_2024-05-01-10-05-00_1.bag` ..., where a smaller number begins the next recording.
* single: every other recording file.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePosixPath

METADATA_NAME = "metadata.yaml"
_RECORDING = re.compile(r".*\.(bag|(mcap|db3)(\.zstd?)?)", re.IGNORECASE | re.DOTALL)
_ROSBAG2 = re.compile(r"(?P<stem>.+?)(_(?P<number>\d+))?(?P<suffix>\.(mcap|db3)(\.zstd?)?)", re.IGNORECASE | re.DOTALL)
_BAG = re.compile(
    r"(?P<prefix>.*)(?P<time>\d{4}-\d\d-\d\d-\d\d-\d\d-\d\d)_(?P<number>\d+)\.bag", re.IGNORECASE | re.DOTALL
)


class GroupKind(str, Enum):
    """What holds the files of a recording together."""

    single = "single"
    split_set = "split"
    rosbag2 = "rosbag2"


@dataclass(frozen=True)
class RecordingGroup:
    """The files of one recording. Name and kind together are unique among the groups of some paths.

    Attributes:
        name: the path of a single file; the path of a rosbag2 folder ("." for the top); the common path of a split
            set, "run.mcap" for `run_0.mcap` and so on.
        members: paths of its data files, in the order of recording.
        metadata_path: the metadata.yaml of a rosbag2 folder; not among the members.
    """

    name: str
    kind: GroupKind
    members: tuple[str, ...]
    metadata_path: str | None = None


def is_recording_name(path: str) -> bool:
    """Say whether a file's name is that of a recording's data file."""
    return _RECORDING.fullmatch(path) is not None


def group(paths: Iterable[str]) -> list[RecordingGroup]:
    """Group relative POSIX paths into recordings, sorted by name. Paths that are none belong to no group."""
    folders: dict[str, list[str]] = defaultdict(list)
    metadata: dict[str, str] = {}
    for path in sorted(set(paths)):
        folder, _, name = path.rpartition("/")
        if is_recording_name(name):
            folders[folder].append(path)
        elif name == METADATA_NAME:
            metadata[folder] = path
    groups = [found for folder, names in folders.items() for found in _group_folder(folder, names, metadata)]
    return sorted(groups, key=lambda found: (found.name, found.kind.value))


def _group_folder(folder: str, paths: list[str], metadata: dict[str, str]) -> list[RecordingGroup]:
    sets: dict[tuple[str, str], list[tuple[int, str]]] = defaultdict(list)
    bags: list[str] = []
    for path in paths:
        match = _ROSBAG2.fullmatch(path)
        if match is None:
            bags.append(path)
        else:
            sets[match["stem"], match["suffix"]].append((int(match["number"] or 0), path))
    groups = _group_bags(bags)
    own = _stem_of_folder(folder, {stem for stem, _ in sets}) if folder in metadata else None
    if own is not None:
        members = sorted(member for (stem, _), found in sets.items() if stem == own for member in found)
        names = tuple(path for _, path in members)
        groups.append(RecordingGroup(folder or ".", GroupKind.rosbag2, names, metadata[folder]))
    for (stem, suffix), found in sets.items():
        if stem != own:
            groups += _group_split(f"{stem}{suffix}", sorted(found))
    return groups


def _stem_of_folder(folder: str, stems: set[str]) -> str | None:
    """Return the stem whose files are those that the folder's metadata.yaml is about."""
    if len(stems) == 1:
        return next(iter(stems))
    named_alike = f"{folder}/{PurePosixPath(folder).name}"
    return named_alike if named_alike in stems else None


def _group_split(name: str, members: list[tuple[int, str]]) -> list[RecordingGroup]:
    if len(members) > 1 and members[0][0] == 0:
        return [RecordingGroup(name, GroupKind.split_set, tuple(path for _, path in members))]
    return [_single(path) for _, path in members]


def _group_bags(paths: list[str]) -> list[RecordingGroup]:
    sets: dict[str, list[tuple[str, int, str]]] = defaultdict(list)
    groups: list[RecordingGroup] = []
    for path in paths:
        match = _BAG.fullmatch(path)
        if match is None:
            groups.append(_single(path))
        else:
            sets[match["prefix"]].append((match["time"], int(match["number"]), path))
    for members in sets.values():
        groups += _group_bag_splits(sorted(members))
    return groups


def _group_bag_splits(members: list[tuple[str, int, str]]) -> list[RecordingGroup]:
    """Cut bags of one prefix, in the order of their times, where the number does not grow."""
    recordings: list[list[str]] = []
    previous = -1
    for _time, number, path in members:
        if number <= previous or not recordings:
            recordings.append([])
        recordings[-1].append(path)
        previous = number
    return [
        RecordingGroup(found[0], GroupKind.split_set, tuple(found)) if len(found) > 1 else _single(found[0])
        for found in recordings
    ]


def _single(path: str) -> RecordingGroup:
    return RecordingGroup(path, GroupKind.single, (path,))
