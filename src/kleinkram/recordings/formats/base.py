"""The interface of a file format: how it is recognised, and what can be read of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import NamedTuple, Protocol

from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import SourceError, TooCostly
from kleinkram.recordings.merge_messages import MessagePiece
from kleinkram.recordings.messages import Channel, Selection
from kleinkram.recordings.model import RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import FileSource, SequentialReader, Source, SourceReader
from kleinkram.recordings.temporary_files import TooLarge, temporary_database

HEAD_BYTES = 4096  # bytes at the start of a file by which it is recognised
LONG_HEAD_BYTES = 65536  # of a database, whose schema is at its start
MAX_REMOTE_SCAN_BYTES = 2**30  # bytes of a file without index that are read over a network unless more is allowed


class Head(NamedTuple):
    """The first bytes of a file. `path`: where it is on this machine, or None."""

    data: bytes
    path: Path | None = None


@dataclass
class RecordingFile:
    """A file to be opened.

    `path`: on this machine. `database`: the database that SQLite reads, in place or a copy. `unpacked`: what is inside
    a file that is compressed as a whole.
    """

    source: Source
    path: Path | None = None
    database: Path | None = None
    unpacked: RecordingFile | None = None

    @property
    def base_name(self) -> str:
        """Its name without folder."""
        return PurePosixPath(self.source.name).name


@dataclass(frozen=True)
class OpenContext:
    """Limits for opening a file, and what is known of its recording.

    Attributes:
        stack: closes what is opened here, with the recording.
        max_bytes: a file with more bytes is not scanned to open it; None: of remote files, `MAX_REMOTE_SCAN_BYTES`.
        message_compression: of single messages, by metadata.yaml.
        logs: logs and journals of databases, by their names.
    """

    problem_log: ProblemLog
    stack: ExitStack
    max_bytes: int | None = None
    message_compression: str = ""
    logs: Mapping[str, Source] = field(default_factory=dict)

    def check_cost(self, source: Source, why: str) -> None:
        """Raise `TooCostly` if a file is too large to be scanned in order to open it."""
        max_bytes = self.max_bytes
        if max_bytes is None and not isinstance(source, FileSource):
            max_bytes = MAX_REMOTE_SCAN_BYTES
        if max_bytes is not None and source.size_bytes > max_bytes:
            raise TooCostly(source.name, source.size_bytes, why)

    def copy(self, read: Callable[[int], bytes], name: str, logs: Mapping[str, Source] | None = None) -> Path:
        """Write a file, and a database's logs by their suffixes, to temporary files until the recording is closed."""
        reads = {suffix: SourceReader(log).read for suffix, log in (logs or {}).items()}
        try:
            return self.stack.enter_context(temporary_database(read, reads))
        except TooLarge as error:
            raise SourceError(f"{name}: {error}") from error


@dataclass(frozen=True)
class Format:
    """One file format.

    Attributes:
        matches: whether a file is of this format, tried in the order of `FORMATS`.
        extensions: those that promise this format, or one that is as good.
        scan: reads a whole file; None: such a file is only recognised.
        summarise: reads less than the file where possible, and returns `pending` if a scan is needed and the file is
            larger than the number; None: a small file is scanned, a larger one only recognised.
        open: opens its messages; None: it holds none that are read, for the reason `refusal`.
    """

    kind: RecordingFormat
    matches: Callable[[Head], bool]
    description: str
    extensions: tuple[str, ...] = ()
    is_text: bool = False
    scan: Callable[[SequentialReader], RecordingSummary] | None = None
    summarise: Callable[[Source, int], RecordingSummary] | None = None
    open: Callable[[RecordingFile, OpenContext], OpenedFile] | None = None
    refusal: str = ""


@dataclass(frozen=True)
class MemberContents:
    """The content of a file by its index: channels by number, messages by channel, inclusive times; None: unknown.

    `profile`: of an MCAP, such as "ros2".
    """

    channels: Mapping[int, Channel]
    counts: Mapping[int, int] | None
    message_count: int | None
    start_ns: int | None
    end_ns: int | None
    profile: str = ""

    def select(self, selection: Selection) -> dict[int, Channel]:
        """Return the channels of the selected topics."""
        return {
            number: channel
            for number, channel in self.channels.items()
            if selection.topics is None or channel.topic in selection.topics
        }


class OtherRecord(NamedTuple):
    """An attachment or metadata record of an MCAP. `length`: with its head; `index_fields`: what its index repeats."""

    opcode: int
    start: int
    length: int
    index_fields: bytes


class Segment(NamedTuple):
    """A part of a recording that is read as a whole: a chunk, or a slice of a database.

    Attributes:
        first_ns: earliest log time that it may contain, inclusive.
        last_ns: latest log time that it may contain, inclusive.
        size_bytes: about the bytes that reading it takes.
        topics: with messages in it; None if the index does not say.
        order: number of the file, and of the segment in it.
    """

    first_ns: int
    last_ns: int
    size_bytes: int
    topics: frozenset[str] | None
    order: tuple[int, int]


class OpenedFile(Protocol):
    """One file of a recording."""

    @property
    def contents(self) -> MemberContents:
        """The content by the file's index."""

    @property
    def summary(self) -> RecordingSummary | None:
        """The summary, if the file was scanned to be opened."""

    def pieces(self, selection: Selection, order: tuple[int, ...]) -> Iterator[MessagePiece]:
        """Yield the parts that may hold selected messages, by first time."""

    def segments(self, selection: Selection, file_number: int) -> Iterator[Segment]:
        """Yield the segments that may hold selected messages, by first time."""

    def segment_pieces(self, segment: Segment, selection: Selection) -> Iterator[MessagePiece]:
        """Yield the selected messages of one segment."""
