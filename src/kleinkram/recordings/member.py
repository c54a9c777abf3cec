"""One file of a recording, opened: what it says of itself, and its messages as pieces to be merged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from kleinkram.recordings.chunk_reader import ChunkedFile, ChunkFormat, pieces_of
from kleinkram.recordings.chunk_table import ChunkTable
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import TooCostly
from kleinkram.recordings.index_check import IndexCheck, contradicts_itself
from kleinkram.recordings.merge import MessagePiece
from kleinkram.recordings.messages import Channel, Selection
from kleinkram.recordings.model import RecordingSummary
from kleinkram.recordings.sources import Source


@dataclass(frozen=True)
class MemberContents:
    """What a file says of itself without being read; None: it does not say.

    Attributes:
        channels: by their number in the file.
        counts: messages by channel; a channel that is not among them has none.
        start_ns: earliest log time, inclusive.
        end_ns: latest log time, inclusive.
    """

    channels: Mapping[int, Channel]
    counts: Mapping[int, int] | None
    message_count: int | None
    start_ns: int | None
    end_ns: int | None


class Member(Protocol):
    """One file of a recording."""

    @property
    def contents(self) -> MemberContents:
        """What it says of itself."""

    @property
    def summary(self) -> RecordingSummary | None:
        """What is in it, if it was read from end to end to be opened."""

    def pieces(self, selection: Selection, order: tuple[int, ...]) -> Iterator[MessagePiece]:
        """Yield what may hold the messages that are wanted, by first time."""


class ChunkedMember:
    """A file made of chunks.

    Args of `__init__`:
        table: its chunks.
        summary: what is in it, if it was scanned to be opened.
        with_index_check: whether the table comes from the file's own index, which may be wrong.
        claimed_span: first and last time of all messages, as the statistics say.
    """

    def __init__(
        self,
        source: Source,
        chunk_format: ChunkFormat,
        table: ChunkTable,
        contents: MemberContents,
        problem_log: ProblemLog,
        *,
        summary: RecordingSummary | None = None,
        with_index_check: bool = False,
        claimed_span: tuple[int | None, int | None] = (None, None),
    ) -> None:
        check = IndexCheck(source, table, problem_log, chunk_format.read_message_index) if with_index_check else None
        if check is not None and contradicts_itself(table, claimed_span):
            check.doubt()
            check.settle()
        self._contents = contents
        self._file = ChunkedFile(source, chunk_format, table, contents.channels, problem_log, check=check)
        self.summary = summary

    @property
    def contents(self) -> MemberContents:
        """What it says of itself; the span by its message indexes once the index was seen to be wrong."""
        check = self._file.check
        if check is None or check.span is None:
            return self._contents
        return replace(self._contents, start_ns=check.span[0], end_ns=check.span[1])

    def pieces(self, selection: Selection, order: tuple[int, ...]) -> Iterator[MessagePiece]:
        """Yield the chunks that may hold the messages that are wanted, by first time."""
        return pieces_of(self._file, selection, order)

    def doubt_index(self) -> None:
        """State that the file's index was seen to be wrong."""
        if self._file.check is not None:
            self._file.check.doubt()


def check_cost(source: Source, most_bytes: int | None, why: str) -> None:
    """Make sure that a file may be read whole; `most_bytes` None: whatever its size.

    Raises:
        TooCostly: it has more bytes.
    """
    if most_bytes is not None and source.size_bytes > most_bytes:
        raise TooCostly(source.name, source.size_bytes, why)
