"""From what a person has (a file, a folder, sources) to the opened files of one recording."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Protocol, runtime_checkable

from kleinkram.recordings.combine_summaries import combine, combine_folder
from kleinkram.recordings.compression import open_decompressed
from kleinkram.recordings.damage_report import Noticed
from kleinkram.recordings.errors import Malformed, NotARecording, SeveralRecordings, SourceError
from kleinkram.recordings.formats.base import sniff
from kleinkram.recordings.formats.mcap.format import open_mcap
from kleinkram.recordings.formats.rosbag1.format import open_bag
from kleinkram.recordings.formats.rosbag2.database import LOG_SUFFIXES, find_leftovers, not_read, replay, replayed_copy
from kleinkram.recordings.formats.rosbag2.db3 import DatabaseMember
from kleinkram.recordings.formats.rosbag2.metadata import (
    MAX_TEXT,
    Rosbag2Metadata,
    compare_names,
    parse_rosbag2_metadata,
)
from kleinkram.recordings.formats.rosbag2.recovered_member import open_recovered
from kleinkram.recordings.grouping import METADATA_NAME, RecordingGroup, read_folder, recording_of_metadata
from kleinkram.recordings.member import ChunkedMember, Member, check_cost
from kleinkram.recordings.model import RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import FileSource, Source, SourceForward
from kleinkram.recordings.summary import scan, summarise
from kleinkram.recordings.temporary_files import MAX_SPOOL_BYTES, TooLarge, temporary_database


@runtime_checkable
class HasSources(Protocol):
    """Something that stands for the files of one recording, such as a file on a server."""

    def sources(self) -> Sequence[Source]:
        """Return the files in the order of recording, a metadata.yaml among them where there is one."""

    def close(self) -> None:
        """Give up what the sources need; called once, when the recording is closed."""


MAX_UNASKED_BYTES = 2**30
"""Bytes of a file without index that are read over a network unless more is allowed."""

MAX_SCANNED_FOR_PROBLEMS = 64 * 2**20
"""Bytes of a file that `Recording.problems` reads whole where the file's index is enough to read its messages, and not
to say what is wrong with it."""

_READ_WHOLE = {
    RecordingFormat.rosbag2_db3: "a rosbag2 database (db3) is read from a local copy",
    RecordingFormat.zstd: "it is compressed as a whole",
}

_UNREAD = {RecordingFormat.ulog: "ULog of PX4", RecordingFormat.svo2: "SVO2 of a ZED camera"}

_SUMMARY = "which holds no messages: use `klein inspect` or `kleinkram.recordings.inspect` for its"
_TRAJECTORY_FACTS = "number of poses, path length and time span, and `numpy.loadtxt` or evo for the poses"
_USE_INSTEAD = {
    RecordingFormat.tum: f"a trajectory (TUM), {_SUMMARY} {_TRAJECTORY_FACTS}",
    RecordingFormat.kitti: f"a trajectory (KITTI), {_SUMMARY} {_TRAJECTORY_FACTS}",
    RecordingFormat.csv: f"a table (CSV), {_SUMMARY} columns, rows and poses, and `pandas.read_csv` for the rows",
}

Openable = str | os.PathLike[str] | Source | HasSources | Sequence[Source]


@dataclass(frozen=True)
class Opened:
    """The files of a recording.

    Attributes:
        files: names of the data files, in the order of recording.
        members: the same files.
        summarise: returns what `klein inspect` says of the recording.
        stack: what is to be closed with them.
    """

    name: str
    files: tuple[str, ...]
    members: tuple[Member, ...]
    summarise: Callable[[], RecordingSummary]
    stack: ExitStack


def open_members(what: Openable, noticed: Noticed, *, most_bytes: int | None = None) -> Opened:
    """Open the files of a recording; `most_bytes` as in `Recording.open`.

    Raises:
        FileNotFoundError: there is no such file or folder.
        NotARecording: there are no messages in it that we read.
        SeveralRecordings: the folder holds several.
        TooCostly: a file has no index that can be used, and more than `most_bytes`.
        SourceError: the bytes cannot be read.
    """
    stack = ExitStack()  # members add to it later, too
    with ExitStack() as on_failure:
        on_failure.callback(stack.close)
        name, files = _files_of(what, stack)
        metadata = _metadata_of(files, noticed)
        data = [file for file in files if file.base_name != METADATA_NAME and not file.is_log]
        if not data:
            raise NotARecording(name, _why_nothing(metadata))
        names = tuple(file.base_name for file in data)
        logs = {file.source.name: file.source for file in files if file.is_log}
        opener = _Opener(_message_compression(metadata), noticed, stack, most_bytes, logs)
        members = tuple(opener.open(file) for file in data)
        on_failure.pop_all()
    return Opened(name, names, members, lambda: opener.summarise(metadata, names), stack)


@dataclass
class _File:
    """A file to be opened.

    Attributes:
        path: where it stands on this machine.
        database: where it stands as a database that SQLite reads: the file itself, or a copy that was made to open it.
        unpacked: what is inside, where the file is compressed as a whole.
    """

    source: Source
    path: Path | None = None
    database: Path | None = None
    unpacked: _File | None = None

    @property
    def base_name(self) -> str:
        return PurePosixPath(self.source.name).name

    @property
    def is_log(self) -> bool:
        """Whether it is the log or journal of a database."""
        return self.source.name.endswith(LOG_SUFFIXES)


def _summary_of(file: _File, member: Member) -> RecordingSummary:
    """Return what is in a file. Where its index is wrong, the member does not believe it any more."""
    summary = member.summary or _summarise(file)
    if isinstance(member, ChunkedMember) and any(problem.code == "index-damaged" for problem in summary.problems):
        member.doubt_index()
    return summary


def _summarise(file: _File) -> RecordingSummary:
    """Say what is in a file as `klein inspect` does. What was copied to open the file is not fetched again.

    Raises:
        SourceError: the bytes cannot be read.
    """
    inner = file.unpacked
    if inner is not None:
        return scan(SourceForward(inner.source, path=inner.path))
    if file.database is not None:
        with FileSource(file.database) as source:
            source.name = file.base_name
            return summarise(source, most_bytes=None)
    if file.path is not None:
        with FileSource(file.path) as source:
            return summarise(source, most_bytes=MAX_SCANNED_FOR_PROBLEMS)
    return summarise(file.source, most_bytes=MAX_SCANNED_FOR_PROBLEMS)


@dataclass(frozen=True)
class _Opener:
    """Opens files, whatever they are; what must be closed later goes onto the stack.

    Attributes:
        summaries: of each file that was opened, a function that returns its summary.
    """

    message_compression: str
    noticed: Noticed
    stack: ExitStack
    most_bytes: int | None
    logs: Mapping[str, Source]
    summaries: list[Callable[[], RecordingSummary]] = field(default_factory=list)

    def summarise(self, metadata: Rosbag2Metadata | None, names: Sequence[str]) -> RecordingSummary:
        """Return what `klein inspect` says of all files together.

        Raises:
            SourceError: the bytes cannot be read.
        """
        summaries = [summarise() for summarise in self.summaries]
        return combine(summaries, names) if metadata is None else combine_folder(metadata, names, summaries)

    def open(self, file: _File) -> Member:
        """Open a file, and note how it is summarised.

        Raises:
            NotARecording: there are no messages in it that we read.
            TooCostly: as `open_members`.
            SourceError: the bytes cannot be read.
        """
        member = self._open(file)
        self.summaries.append(lambda: _summary_of(file, member))
        return member

    def _open(self, file: _File) -> Member:
        kind, most = sniff(file.source), self._most_bytes(file.source)
        if kind is RecordingFormat.unknown and self._logs_of(file):
            kind = RecordingFormat.rosbag2_db3
        if kind is RecordingFormat.mcap:
            compression = self.message_compression
            return open_mcap(file.source, self.noticed, message_compression=compression, most_bytes=most)
        if kind is RecordingFormat.rosbag1:
            return open_bag(file.source, self.noticed, most_bytes=most)
        if kind is RecordingFormat.zstd or (kind is RecordingFormat.rosbag2_db3 and file.path is None):
            check_cost(file.source, most, _READ_WHOLE[kind])
        if kind is RecordingFormat.rosbag2_db3:
            return self._open_database(file)
        if kind is RecordingFormat.zstd:
            return self._open(self._unpack(file))
        if kind is RecordingFormat.rosbag1_old:
            raise NotARecording(file.source.name, "it is a ROS bag 1.x: convert it with 'rosbag migrate'")
        if kind is RecordingFormat.empty:
            raise NotARecording(file.source.name, "it has 0 bytes")
        if kind in _UNREAD:
            raise NotARecording(file.source.name, f"it is a {_UNREAD[kind]}, and reading that format is not supported")
        if kind in _USE_INSTEAD:
            raise NotARecording(file.source.name, f"it is {_USE_INSTEAD[kind]}")
        raise NotARecording(file.source.name, f"its content is that of {kind.value}, which holds no messages")

    def _most_bytes(self, source: Source) -> int | None:
        """Return how many bytes of a file may be read only to open it."""
        if self.most_bytes is not None:
            return self.most_bytes
        return None if isinstance(source, FileSource) else MAX_UNASKED_BYTES

    def _open_database(self, file: _File) -> Member:
        name = file.source.name
        path = file.database = self._whole_database(file)
        compression = self.message_compression

        def recover() -> Member:
            return open_recovered(path, name, self.noticed, self.stack, message_compression=compression)

        return DatabaseMember(path, name, self.noticed, recover, message_compression=compression)

    def _whole_database(self, file: _File) -> Path:
        """Return where a database can be read with what its log and journal hold, if there are any."""
        if file.path is not None:
            left = find_leftovers(file.path, file.base_name)
            copy = self.stack.enter_context(replayed_copy(file.path)) if left else None
            is_applied = copy is not None
            path = copy or file.path
        else:
            name, logs = file.source.name, self._logs_of(file)
            path = self._copy(SourceForward(file.source).read, name, logs)
            left = find_leftovers(path, file.base_name)
            is_applied = bool(left) and replay(path)
            if left and not is_applied:  # half of it may be in this copy
                path = self._copy(SourceForward(file.source).read, name)
        for problem in [*left, *([] if is_applied else not_read(left))]:
            self.noticed.add(problem.code, problem.where, problem.message)
        return path

    def _logs_of(self, file: _File) -> dict[str, Source]:
        """Return the log and journal that were given beside a database, by their suffixes."""
        names = {suffix: f"{file.source.name}{suffix}" for suffix in LOG_SUFFIXES}
        return {suffix: self.logs[name] for suffix, name in names.items() if name in self.logs}

    def _unpack(self, file: _File) -> _File:
        """Decompress a file that is compressed as a whole; if that is damaged, up to there."""
        source = file.source
        content = open_decompressed("zstd", SourceForward(source).read, MAX_SPOOL_BYTES)

        def read(most: int) -> bytes:
            try:
                return content.take_some(most)
            except Malformed as error:
                self.noticed.add("damaged", source.name, f"reading ends here: {error.message}")
                return b""

        path = self._copy(read, source.name)
        unpacked = self.stack.enter_context(FileSource(path))
        unpacked.name = PurePosixPath(source.name).stem
        if sniff(unpacked) is RecordingFormat.zstd:
            raise NotARecording(source.name, "it is compressed more than once")
        file.unpacked = _File(unpacked, path)
        return file.unpacked

    def _copy(self, read: Callable[[int], bytes], name: str, logs: Mapping[str, Source] | None = None) -> Path:
        reads = {suffix: SourceForward(log).read for suffix, log in (logs or {}).items()}
        try:
            return self.stack.enter_context(temporary_database(read, reads))
        except TooLarge as error:
            raise SourceError(f"{name}: {error}") from error


def _message_compression(metadata: Rosbag2Metadata | None) -> str:
    return metadata.compression if metadata is not None and metadata.compression_mode == "message" else ""


def _files_of(what: Openable, stack: ExitStack) -> tuple[str, list[_File]]:
    if isinstance(what, str | os.PathLike):
        path = Path(what)
        return str(path), [_File(stack.enter_context(FileSource(member)), member) for member in _paths_of(path)]
    if isinstance(what, HasSources):
        stack.callback(what.close)
        sources = [*what.sources()]
    elif isinstance(what, Sequence):
        sources = [*what]
    else:
        sources = [what]
    return sources[0].name if sources else "nothing", [_File(source) for source in sources]


def _paths_of(path: Path) -> list[Path]:
    if path.is_file() and path.name == METADATA_NAME:
        own = recording_of_metadata(path)
        if own is None:
            return [path]
        return _paths_in(path.parent, own[1])
    if not path.is_dir():
        if not path.exists():
            raise FileNotFoundError(f"{path}: there is no such file or folder")
        return [path]
    groups = read_folder(path).groups
    if not groups:
        raise NotARecording(str(path), _why_nothing(None))
    if len(groups) > 1:
        raise SeveralRecordings(str(path), [str(path / found.name) for found in groups])
    return _paths_in(path, groups[0])


def _paths_in(folder: Path, found: RecordingGroup) -> list[Path]:
    metadata = [found.metadata_path] if found.metadata_path else []
    return [folder / name for name in [*metadata, *found.members]]


def _why_nothing(metadata: Rosbag2Metadata | None) -> str:
    if metadata is None or not metadata.files:
        return "there is no recording in it"
    return combine_folder(metadata, (), ()).reason or ""


def _metadata_of(files: Iterable[_File], noticed: Noticed) -> Rosbag2Metadata | None:
    """Read the metadata.yaml among the files, and compare it with what is there."""
    names = {file.base_name for file in files}
    for file in files:
        if file.base_name != METADATA_NAME:
            continue
        source = file.source
        text = source.read(0, min(source.size_bytes, MAX_TEXT)).decode("utf-8", "replace")
        metadata = parse_rosbag2_metadata(text) if source.size_bytes <= MAX_TEXT else None
        if metadata is not None and metadata.is_other:
            return None
        if metadata is None:
            noticed.add("metadata-damaged", source.name, "it is not the metadata of a rosbag2 recording")
            return None
        for problem in compare_names(metadata, names - {METADATA_NAME}):
            noticed.add(problem.code, problem.where, problem.message)
        return metadata
    return None
