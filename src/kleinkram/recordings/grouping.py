"""Which files make one recording, by their names, and by what a metadata.yaml says where that is known.

* rosbag2: a folder with metadata.yaml and data files (.mcap, .db3, also .zstd) of one stem, such as `run_0.mcap`,
  `run_1.mcap`. With several stems, those of the folder's own name; if there are none, metadata.yaml is something else.
  A metadata.yaml that is known to say something else counts as none.
* split: `name_0.mcap`, `name_1.mcap` ... without metadata.yaml, if number 0 is there (else they are numbered
  recordings); for bags what `rosbag record --split` makes, `prefix_2024-05-01-10-00-00_0.bag`,
  `prefix_2024-05-01-10-05-00_1.bag` ..., where a smaller number begins the next recording.
  Where it is known what metadata.yaml says, the files that it names come first and in its order; files of the same
  stem that it does not name follow them; a folder of which no file is there is a recording without members.
* single: every other recording file.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import PurePosixPath

from kleinkram.recordings.rosbag2.metadata import Rosbag2Metadata

METADATA_NAME = "metadata.yaml"
_RECORDING = re.compile(r".*\.(bag|mcap|db3|svo2)(\.zstd?)?", re.IGNORECASE | re.DOTALL)
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


def group(paths: Iterable[str], stated: Mapping[str, Rosbag2Metadata] | None = None) -> list[RecordingGroup]:
    """Group relative POSIX paths into recordings, sorted by name. Paths that are none belong to no group.

    `stated`: what the metadata.yaml of each path among `paths` says, where it could be read.
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
        said = (stated or {}).get(metadata.get(folder, ""))
        groups += _group_folder(folder, folders[folder], metadata.get(folder), said)
    return sorted(groups, key=lambda found: (found.name, found.kind.value))


def _group_folder(
    folder: str, paths: list[str], metadata_path: str | None, said: Rosbag2Metadata | None
) -> list[RecordingGroup]:
    if metadata_path is None or (said is not None and said.is_other):
        return _group_by_name(paths)
    own = _members(folder, paths, said)
    if not own and (said is None or not said.files):
        return _group_by_name(paths)
    found = RecordingGroup(folder or ".", GroupKind.rosbag2, tuple(own), metadata_path)
    return [found, *_group_by_name([path for path in paths if path not in set(own)])]


def _members(folder: str, paths: list[str], said: Rosbag2Metadata | None) -> list[str]:
    """Return the files that the metadata.yaml of a folder is about."""
    by_stem: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for path in paths:
        match = _ROSBAG2.fullmatch(path)
        if match is not None:
            by_stem[match["stem"]].append((int(match["number"] or 0), path))
    named = {PurePosixPath(path).name: number for number, path in enumerate(said.files)} if said else {}
    here = sorted((named[name], path) for path in paths if (name := PurePosixPath(path).name) in named)
    stem = _stem_of_folder(folder, set(by_stem))
    if not here:
        return [path for _, path in sorted(by_stem[stem])] if stem is not None else []
    stems = {match["stem"] for _, path in here if (match := _ROSBAG2.fullmatch(path))}
    surplus = sorted(member for stem in stems for member in by_stem[stem] if member[1] not in {p for _, p in here})
    return [path for _, path in (*here, *surplus)]


def _stem_of_folder(folder: str, stems: set[str]) -> str | None:
    """Return the stem whose files are those that the folder's metadata.yaml is about."""
    if len(stems) == 1:
        return next(iter(stems))
    named_alike = f"{folder}/{PurePosixPath(folder).name}"
    return named_alike if named_alike in stems else None


def _group_by_name(paths: Iterable[str]) -> list[RecordingGroup]:
    sets: dict[tuple[str, str], list[tuple[int, str]]] = defaultdict(list)
    bags: list[str] = []
    for path in paths:
        match = _ROSBAG2.fullmatch(path)
        if match is None:
            bags.append(path)
        else:
            sets[match["stem"], match["suffix"]].append((int(match["number"] or 0), path))
    splits = [found for (stem, suffix), members in sets.items() for found in _group_split(stem + suffix, members)]
    return [*_group_bags(bags), *splits]


def _group_split(name: str, members: list[tuple[int, str]]) -> list[RecordingGroup]:
    members = sorted(members)
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
