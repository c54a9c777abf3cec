"""What is in local files and folders, without a server: the content of `klein inspect`."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from kleinkram.recordings.combining import combine
from kleinkram.recordings.grouping import GroupKind, RecordingGroup, group
from kleinkram.recordings.model import Problem, RecordingSummary
from kleinkram.recordings.rosbag2.metadata import MAX_TEXT, compare_members, parse_rosbag2_metadata
from kleinkram.recordings.sources import FileSource
from kleinkram.recordings.summary import summarise


class InspectionKind(str, Enum):
    """Whether one file or a recording of several was looked at."""

    file = "file"
    recording = "recording"


@dataclass(frozen=True)
class Inspection:
    """What is in one file, or in one recording.

    Attributes:
        path: as it was given, or below the folder that was given.
        members: the data files, as paths like `path`.
        summary: of the file, or of all members together.
    """

    path: str
    kind: InspectionKind
    members: tuple[str, ...]
    summary: RecordingSummary


def inspect_paths(paths: Iterable[str | os.PathLike[str]]) -> list[Inspection]:
    """Look into files and folders, in the order given; of a folder, each recording inside it.

    Raises:
        FileNotFoundError: a path does not exist.
        SourceError: a file cannot be read.
    """
    found: list[Inspection] = []
    for given in paths:
        path = Path(given)
        if path.is_dir():
            found += _inspect_folder(path)
        elif path.exists():
            found.append(_inspect_file(path))
        else:
            raise FileNotFoundError(f"{path}: there is no such file or folder")
    return found


def to_plain(inspection: Inspection) -> dict[str, object]:
    """Return an inspection as what `json.dumps` takes: the stable shape of `klein inspect --json`."""
    summary = inspection.summary
    return {
        "path": inspection.path,
        "kind": inspection.kind.value,
        "members": list(inspection.members),
        "format": summary.format.value,
        "content": summary.content.value,
        "reason": summary.reason,
        "problems": [vars(problem) for problem in summary.problems],
        "message_count": summary.message_count,
        "start_ns": summary.start_ns,
        "end_ns": summary.end_ns,
        "compression": list(summary.compression),
        "topics": [
            {
                "name": topic.name,
                "type": topic.message_type,
                "message_encoding": topic.message_encoding,
                "count": topic.count,
                "first_ns": topic.first_ns,
                "last_ns": topic.last_ns,
                "rate_hz": topic.rate_hz,
                "longest_gap_ns": topic.longest_gap_ns,
                "head_gap_ns": topic.head_gap_ns,
                "tail_gap_ns": topic.tail_gap_ns,
                "out_of_order": topic.out_of_order_count,
            }
            for topic in summary.topics
        ],
    }


def _inspect_file(path: Path) -> Inspection:
    return Inspection(str(path), InspectionKind.file, (str(path),), _summarise_file(path))


def _inspect_folder(folder: Path) -> list[Inspection]:
    names = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    return [_inspect_group(folder, found) for found in group(names)]


def _inspect_group(folder: Path, found: RecordingGroup) -> Inspection:
    if found.kind is GroupKind.single:
        return _inspect_file(folder / found.members[0])
    members = tuple(str(folder / name) for name in found.members)
    summary = combine([_summarise_file(Path(member)) for member in members])
    if found.metadata_path is not None:
        problems = _compare_with_metadata(folder / found.metadata_path, members, summary)
        summary = replace(summary, problems=(*problems, *summary.problems))
    return Inspection(str(folder / found.name), InspectionKind.recording, members, summary)


def _summarise_file(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return summarise(source)


def _compare_with_metadata(path: Path, members: tuple[str, ...], summary: RecordingSummary) -> list[Problem]:
    with path.open(encoding="utf-8", errors="replace") as file:
        metadata = parse_rosbag2_metadata(file.read(MAX_TEXT + 1))
    if metadata is None:
        return [Problem("metadata-damaged", path.name, "it is not the metadata of a rosbag2 recording")]
    problems = compare_members(metadata, [Path(member).name for member in members])
    claimed, counted = metadata.message_count, summary.message_count
    if not problems and None not in (claimed, counted) and claimed != counted:
        message = f"it says {claimed} messages, the files hold {counted}"
        problems.append(Problem("metadata-disagrees", path.name, message))
    return problems
