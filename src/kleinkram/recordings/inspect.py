"""Summarises local files and folders, for `klein inspect`."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Protocol

from kleinkram.recordings import recording_groups
from kleinkram.recordings.combine_summaries import combine, combine_folder
from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME
from kleinkram.recordings.model import Content, Depth, RecordingFormat, RecordingSummary
from kleinkram.recordings.recording_groups import FolderRecordings, RecordingGroup, RecordingGroupKind
from kleinkram.recordings.sources import FileSource, SourceReader
from kleinkram.recordings.summary import scan, summarise

_TOPIC_FIELDS = (
    *("message_encoding", "count", "first_ns", "last_ns", "rate_hz"),
    *("longest_gap_ns", "head_gap_ns", "tail_gap_ns"),
)


class ScanProgress(Protocol):
    """Receives the progress of a scan."""

    def began(self, path: str, size_bytes: int) -> None:
        """A file is being read."""

    def moved(self, size_bytes: int) -> None:
        """More of its bytes were read."""

    def ended(self) -> None:
        """The file was read."""


class InspectionKind(str, Enum):
    """Inspected object: a file, a recording of several files, or an unreadable folder."""

    file = "file"
    recording = "recording"
    folder = "folder"


@dataclass(frozen=True)
class Inspection:
    """The summary of one file or recording.

    Attributes:
        path: as it was given, or below the folder that was given.
        members: the data files, as paths like `path`.
        summary: of the file, or of all members together. Its content is `error` where one could not be read, with
            why in `reason`.
    """

    path: str
    kind: InspectionKind
    members: tuple[str, ...]
    summary: RecordingSummary


def inspect_paths(
    paths: Iterable[str | os.PathLike[str]], *, depth: Depth = Depth.summary, progress: ScanProgress | None = None
) -> list[Inspection]:
    """Inspect files and folders, in the given order; of a folder, each recording in it.

    `Depth.summary` reads indexes, and the whole file where it has none. `Depth.scan` reads every byte of every file;
    `progress` then receives the number of bytes read. A metadata.yaml of rosbag2 is for its recording. A file or
    folder that cannot be read is an inspection of its own and hides no other.

    Raises:
        FileNotFoundError: a path does not exist; nothing was read.
    """
    inspector = _FileInspector(depth, progress)
    all_paths = [Path(path) for path in paths]
    for path in all_paths:
        if not path.exists():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    inspections: list[Inspection] = []
    for path in all_paths:
        if path.is_dir():
            inspections += inspector.folder(path)
        else:
            inspections.append(inspector.metadata(path) if path.name == METADATA_NAME else inspector.file(path))
    return inspections


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
                **{name: getattr(topic, name) for name in _TOPIC_FIELDS},
                "out_of_order": topic.out_of_order_count,
            }
            for topic in summary.topics
        ],
        "depth": summary.depth.value,
        "lost": vars(summary.lost) if summary.lost is not None else None,
        "facts": [vars(fact) for fact in summary.facts],
    }


@dataclass(frozen=True)
class _FileInspector:
    """Summarises or scans files; a failure becomes the content `error`."""

    depth: Depth
    progress: ScanProgress | None

    def file(self, path: Path) -> Inspection:
        return Inspection(str(path), InspectionKind.file, (str(path),), self.summary(path))

    def summary(self, path: Path) -> RecordingSummary:
        try:
            if self.depth is Depth.summary:
                with FileSource(path) as source:
                    return summarise(source)
            with FileSource(path) as source:
                if self.progress is None:
                    return scan(SourceReader(source))
                self.progress.began(str(path), source.size_bytes)
                try:
                    return scan(_ProgressReader(source, self.progress))
                finally:
                    self.progress.ended()
        except SourceError as error:
            return _unreadable(str(error))

    def metadata(self, path: Path) -> Inspection:
        try:
            own = recording_groups.recording_of_metadata(path)
        except SourceError as error:
            return Inspection(str(path), InspectionKind.file, (str(path),), _unreadable(str(error)))
        return self.file(path) if own is None else self.group(path.parent, own[1], own[0])

    def folder(self, folder: Path) -> Iterator[Inspection]:
        recordings = recording_groups.read_folder(folder)
        for item in recordings.unreadable_folders:
            summary = _unreadable(f"{item.path}: cannot be read: {item.reason}")
            yield Inspection(str(item.path), InspectionKind.folder, (), summary)
        for name, error in recordings.unreadable_files.items():
            path = str(folder / name)
            yield Inspection(path, InspectionKind.file, (path,), _unreadable(str(error)))
        for group in recordings.groups:
            yield self.group(folder, group, recordings)

    def group(self, folder: Path, group: RecordingGroup, beside: FolderRecordings) -> Inspection:
        if group.kind is RecordingGroupKind.single:
            return self.file(folder / group.members[0])
        members = tuple(str(folder / name) for name in group.members)
        names = [Path(member).name for member in members]
        summaries = [self.summary(Path(member)) for member in members]
        if group.kind is RecordingGroupKind.rosbag2:
            summary = combine_folder(beside.metadata_of(group), names, summaries)
        else:
            summary = combine(summaries, names)
        return Inspection(str(folder / group.name), InspectionKind.recording, members, summary)


class _ProgressReader(SourceReader):
    def __init__(self, source: FileSource, progress: ScanProgress) -> None:
        super().__init__(source)
        self._progress = progress

    def read(self, length: int) -> bytes:
        data = super().read(length)
        self._progress.moved(len(data))
        return data


def _unreadable(reason: str) -> RecordingSummary:
    return RecordingSummary(RecordingFormat.unknown, Content.error, reason)
