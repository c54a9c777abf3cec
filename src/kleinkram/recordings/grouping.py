"""Which files make one recording, by their names only.

A rosbag2 folder (one with metadata.yaml) is one recording; so is a split set (`name_0.mcap`, `name_1.mcap`; ROS 1:
`name_2024-05-01-10-00-00_0.bag`, `..._1.bag`). Every other recording file is a recording by itself.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePosixPath

METADATA_NAME = "metadata.yaml"
_ROSBAG2_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd", ".mcap.zst", ".db3.zst")
_RECORDING_SUFFIXES = (*_ROSBAG2_SUFFIXES, ".bag")
_SPLIT = re.compile(r"(?P<stem>.+)_(?P<number>\d+)(?P<suffix>\.(mcap|db3|bag)(\.zstd?)?)")


class GroupKind(str, Enum):
    """What holds the files of a recording together."""

    single = "single"
    split_set = "split"
    rosbag2 = "rosbag2"


@dataclass(frozen=True)
class RecordingGroup:
    """The files of one recording.

    Attributes:
        name: path without suffix of a file or of a split set; path of a rosbag2 folder ("." for the top).
        members: paths of its data files; of a split set in the order of its numbers.
        metadata_path: the metadata.yaml of a rosbag2 folder; not among the members.
    """

    name: str
    kind: GroupKind
    members: tuple[str, ...]
    metadata_path: str | None = None


def is_recording_name(path: str) -> bool:
    """Say whether a file's name is that of a recording's data file."""
    return path.lower().endswith(_RECORDING_SUFFIXES)


def group(paths: Iterable[str]) -> list[RecordingGroup]:
    """Group relative POSIX paths into recordings, sorted by name. Paths that are none belong to no group."""
    folders: dict[str, list[str]] = defaultdict(list)
    for path in sorted(set(paths)):
        folders[str(PurePosixPath(path).parent)].append(path)
    groups: list[RecordingGroup] = []
    for folder, members in folders.items():
        groups += _group_folder(folder, members)
    return sorted(groups, key=lambda found: (found.name, found.members))


def _group_folder(folder: str, paths: list[str]) -> list[RecordingGroup]:
    metadata = next((path for path in paths if PurePosixPath(path).name == METADATA_NAME), None)
    left = [path for path in paths if is_recording_name(path)]
    groups: list[RecordingGroup] = []
    members = [path for path in left if path.lower().endswith(_ROSBAG2_SUFFIXES)]
    if metadata is not None and members:
        members.sort(key=_split_order)
        groups.append(RecordingGroup(folder, GroupKind.rosbag2, tuple(members), metadata))
        left = [path for path in left if path not in set(members)]
    return groups + _group_splits(left)


def _group_splits(paths: list[str]) -> list[RecordingGroup]:
    sets: dict[tuple[str, str], list[str]] = defaultdict(list)
    groups: list[RecordingGroup] = []
    for path in paths:
        match = _SPLIT.fullmatch(path)
        if match:
            sets[match["stem"], match["suffix"]].append(path)
        else:
            groups.append(_single(path))
    for (stem, _suffix), members in sets.items():
        if len(members) == 1:
            groups.append(_single(members[0]))
        else:
            groups.append(RecordingGroup(stem, GroupKind.split_set, tuple(sorted(members, key=_split_order))))
    return groups


def _single(path: str) -> RecordingGroup:
    return RecordingGroup(_without_suffix(path), GroupKind.single, (path,))


def _without_suffix(path: str) -> str:
    suffix = max((s for s in _RECORDING_SUFFIXES if path.lower().endswith(s)), key=len)
    return path[: -len(suffix)]


def _split_order(path: str) -> tuple[str, int, str]:
    match = _SPLIT.fullmatch(path)
    return (match["stem"], int(match["number"]), path) if match else (path, -1, path)
