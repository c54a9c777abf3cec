"""Opens the files of one recording: a path, a folder, sources, or an object with sources."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from kleinkram.recordings.chunk_reader import ChunkedMember
from kleinkram.recordings.combine_summaries import combine, combine_folder
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import NotARecording, SeveralRecordings
from kleinkram.recordings.formats.base import OpenContext, OpenedFile, RecordingFile
from kleinkram.recordings.formats.rosbag2 import metadata as rosbag2
from kleinkram.recordings.formats.rosbag2.database import LOG_SUFFIXES
from kleinkram.recordings.formats.rosbag2.db3 import ROSBAG2_DB3
from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME, Rosbag2Metadata
from kleinkram.recordings.formats.text_files import UNKNOWN
from kleinkram.recordings.formats.zstd_file import FILE_ZSTD
from kleinkram.recordings.model import RecordingSummary
from kleinkram.recordings.recording_groups import read_folder, recording_of_metadata
from kleinkram.recordings.sources import FileSource, Source, SourceReader
from kleinkram.recordings.summary import format_of, scan, summarise


@runtime_checkable
class HasSources(Protocol):
    """Something with the files of one recording, such as a file on a server."""

    def sources(self) -> Sequence[Source]:
        """Return the files in the order of recording, a metadata.yaml among them where there is one."""

    def close(self) -> None:
        """Release the sources; called once, when the recording is closed."""


MAX_SCANNED_FOR_PROBLEMS = 64 * 2**20
"""Maximum size of a file that `Recording.problems` scans if its index is enough for messages, but not for a summary."""

Openable = str | os.PathLike[str] | Source | HasSources | Sequence[Source]


@dataclass(frozen=True)
class Opened:
    """The opened files of a recording, in the order of recording.

    `sources`: of all files, a metadata.yaml and logs of databases among them. `summarise`: as `klein inspect`.
    `scan_files`: as `klein inspect --deep`, file by file.
    """

    name: str
    files: tuple[str, ...]
    members: tuple[OpenedFile, ...]
    sources: tuple[Source, ...]
    summarise: Callable[[], RecordingSummary]
    scan_files: Callable[[], tuple[RecordingSummary, ...]]
    stack: ExitStack


def open_members(what: Openable, problem_log: ProblemLog, *, max_bytes: int | None = None) -> Opened:
    """Open the files of a recording; arguments and errors as in `Recording.open`."""
    stack = ExitStack()  # members add to it later, too
    with ExitStack() as on_failure:
        on_failure.callback(stack.close)
        name, files = _files_of(what, stack)
        metadata = _metadata_of(files, problem_log)
        logs = {file.source.name: file.source for file in files if file.source.name.endswith(LOG_SUFFIXES)}
        data = [file for file in files if file.base_name != METADATA_NAME and file.source.name not in logs]
        if not data:
            raise NotARecording(name, _why_nothing(metadata))
        names = tuple(file.base_name for file in data)
        is_packed = metadata is not None and metadata.compression_mode == "message"
        compression = metadata.compression if metadata is not None and is_packed else ""
        context = OpenContext(problem_log, stack, max_bytes, compression, logs)
        members = tuple(_open_file(file, context) for file in data)
        on_failure.pop_all()

    def summarise_all() -> RecordingSummary:
        summaries = [_summary_of(file, member) for file, member in zip(data, members, strict=True)]
        return combine(summaries, names) if metadata is None else combine_folder(metadata, names, summaries)

    def scan_files() -> tuple[RecordingSummary, ...]:
        return tuple(member.summary or _scan(file) for file, member in zip(data, members, strict=True))

    sources = tuple(file.source for file in files)
    return Opened(name, names, members, sources, summarise_all, scan_files, stack)


def _summary_of(file: RecordingFile, member: OpenedFile) -> RecordingSummary:
    summary = member.summary or _summarise(file)
    if (
        isinstance(member, ChunkedMember)
        and member.check
        and any(problem.code == "index-damaged" for problem in summary.problems)
    ):
        member.check.mark_wrong()
    return summary


def _summarise(file: RecordingFile) -> RecordingSummary:
    """Summarise a file as `klein inspect` does, without fetching copies again."""
    if file.unpacked is not None:
        return scan(SourceReader(file.unpacked.source))
    path = file.database or file.path
    if path is None:
        return summarise(file.source, max_bytes=MAX_SCANNED_FOR_PROBLEMS)
    with FileSource(path) as source:
        source.name = file.base_name
        return summarise(source, max_bytes=None if file.database else MAX_SCANNED_FOR_PROBLEMS)


def _scan(file: RecordingFile) -> RecordingSummary:
    """Scan a file, without fetching copies again."""
    if file.unpacked is not None:
        summary = scan(SourceReader(file.unpacked.source))
        return replace(summary, compression=(*summary.compression, FILE_ZSTD))
    if file.database is None:
        return scan(SourceReader(file.source))
    with FileSource(file.database) as source:
        source.name = file.base_name
        return scan(SourceReader(source))


def _open_file(file: RecordingFile, context: OpenContext) -> OpenedFile:
    file_format = format_of(file.source)
    if file_format is UNKNOWN and any(f"{file.source.name}{suffix}" in context.logs for suffix in LOG_SUFFIXES):
        file_format = ROSBAG2_DB3  # all of its tables may be in the log
    if file_format.open is None:
        raise NotARecording(file.source.name, file_format.refusal)
    return file_format.open(file, context)


def _files_of(what: Openable, stack: ExitStack) -> tuple[str, list[RecordingFile]]:
    if isinstance(what, str | os.PathLike):
        path = Path(what)
        return str(path), [RecordingFile(stack.enter_context(FileSource(member)), member) for member in _paths_of(path)]
    if isinstance(what, HasSources):
        stack.callback(what.close)
        sources = [*what.sources()]
    elif isinstance(what, Sequence):
        sources = [*what]
    else:
        sources = [what]
    return sources[0].name if sources else "nothing", [RecordingFile(source) for source in sources]


def _paths_of(path: Path) -> list[Path]:
    if path.is_dir():
        groups, folder = read_folder(path).groups, path
        if not groups:
            raise NotARecording(str(path), _why_nothing(None))
        if len(groups) > 1:
            raise SeveralRecordings(str(path), [str(path / group.name) for group in groups])
        group = groups[0]
    elif path.is_file() and path.name == METADATA_NAME and (own := recording_of_metadata(path)) is not None:
        folder, group = path.parent, own[1]
    elif path.exists():
        return [path]
    else:
        raise FileNotFoundError(f"{path}: there is no such file or folder")
    metadata = [group.metadata_path] if group.metadata_path else []
    return [folder / name for name in [*metadata, *group.members]]


def _why_nothing(metadata: Rosbag2Metadata | None) -> str:
    if metadata is None or not metadata.files:
        return "there is no recording in it"
    return combine_folder(metadata, (), ()).reason or ""


def _metadata_of(files: Sequence[RecordingFile], problem_log: ProblemLog) -> Rosbag2Metadata | None:
    source = next((file.source for file in files if file.base_name == METADATA_NAME), None)
    if source is None:
        return None
    text = source.read(0, min(source.size_bytes, rosbag2.MAX_TEXT)).decode("utf-8", "replace")
    metadata = rosbag2.parse_rosbag2_metadata(text) if source.size_bytes <= rosbag2.MAX_TEXT else None
    if metadata is None:
        problem_log.add("metadata-damaged", source.name, "it is not the metadata of a rosbag2 recording")
        return None
    if metadata.is_other:
        return None
    for problem in rosbag2.compare_names(metadata, {file.base_name for file in files} - {METADATA_NAME}):
        problem_log.add(problem.code, problem.where, problem.message)
    return metadata
