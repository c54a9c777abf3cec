"""The interface of a file format: how it is recognised, and what can be read of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import NamedTuple, Protocol

from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.member import Member
from kleinkram.recordings.model import RecordingFormat, RecordingSummary
from kleinkram.recordings.sources import FileSource, SequentialReader, Source, SourceReader
from kleinkram.recordings.temporary_files import TooLarge, temporary_database

HEAD_BYTES = 4096
"""Bytes at the start of a file by which it is recognised."""

LONG_HEAD_BYTES = 65536
"""Likewise of a database, whose schema is at its start."""

MAX_UNASKED_BYTES = 2**30
"""Bytes of a file without index that are read over a network unless more is allowed."""


class Head(NamedTuple):
    """The first bytes of a file. `path`: where it is on this machine; None: nowhere."""

    data: bytes
    path: Path | None = None


class Summarise(Protocol):
    """Reads as little of a file as it can; one that must be read whole and has more than `most_bytes` is `pending`."""

    def __call__(self, source: Source, /, *, most_bytes: int) -> RecordingSummary:
        """Raise `SourceError` where bytes cannot be read, and nothing else."""


@dataclass
class RecordingFile:
    """A file to be opened.

    Attributes:
        path: where it is on this machine.
        database: where a database is that SQLite reads: the file itself, or a copy that was made to open it.
        unpacked: what is inside, where the file is compressed as a whole.
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
    """What opening a file may cost, and what is known of the recording.

    Attributes:
        stack: closes what is opened here, with the recording.
        most_bytes: a file with more bytes is not read whole to open it; None: as `limit_of` says.
        message_compression: of each message by itself, as metadata.yaml says.
        logs: logs and journals of databases, by their names.
    """

    problem_log: ProblemLog
    stack: ExitStack
    most_bytes: int | None = None
    message_compression: str = ""
    logs: Mapping[str, Source] = field(default_factory=dict)

    def limit_of(self, source: Source) -> int | None:
        """Return how many bytes of a file may be read only to open it; None: all."""
        if self.most_bytes is not None:
            return self.most_bytes
        return None if isinstance(source, FileSource) else MAX_UNASKED_BYTES

    def copy(self, read: Callable[[int], bytes], name: str, logs: Mapping[str, Source] | None = None) -> Path:
        """Write a file, and a database's logs by their suffixes, to temporary files until the recording is closed.

        Raises:
            SourceError: it cannot be read, or there is no room for it.
        """
        reads = {suffix: SourceReader(log).read for suffix, log in (logs or {}).items()}
        try:
            return self.stack.enter_context(temporary_database(read, reads))
        except TooLarge as error:
            raise SourceError(f"{name}: {error}") from error


@dataclass(frozen=True)
class Format:
    """One file format.

    Attributes:
        matches: whether a file is of this format; the formats are asked in the order of the registry.
        extensions: those that promise this format, or one that is as good.
        description: what such a file is, for people.
        scan: reads a whole file; None: such a file is only recognised.
        summarise: None: a small file is scanned, a larger one only recognised.
        open: opens its messages; None: it holds none that are read.
        refusal: why its messages are not read.
    """

    kind: RecordingFormat
    matches: Callable[[Head], bool]
    description: str
    extensions: tuple[str, ...] = ()
    is_text: bool = False
    scan: Callable[[SequentialReader], RecordingSummary] | None = None
    summarise: Summarise | None = None
    open: Callable[[RecordingFile, OpenContext], Member] | None = None
    refusal: str = ""
