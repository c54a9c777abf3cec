"""One file of a recording, opened: what it says of itself, and its messages as pieces to be merged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from operator import gt
from typing import Protocol

from kleinkram.recordings.chunk_reader import ChunkedFile, ChunkFormat, pieces_of, salvage_bag, salvage_mcap
from kleinkram.recordings.chunk_table import ChunkTable, Row
from kleinkram.recordings.damage_report import Noticed
from kleinkram.recordings.errors import NotIndexed, TooCostly
from kleinkram.recordings.formats.mcap import chunks as mcap_chunks
from kleinkram.recordings.formats.mcap.reading_index import McapIndex, read_index, rebuild_index
from kleinkram.recordings.formats.rosbag1 import chunks as bag_chunks
from kleinkram.recordings.formats.rosbag1 import reading_index
from kleinkram.recordings.index_check import IndexCheck
from kleinkram.recordings.merge import Piece
from kleinkram.recordings.messages import Channel, Selection
from kleinkram.recordings.model import RecordingSummary
from kleinkram.recordings.sources import Source


@dataclass(frozen=True)
class Contents:
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
    def contents(self) -> Contents:
        """What it says of itself."""

    @property
    def summary(self) -> RecordingSummary | None:
        """What is in it, if it was read from end to end to be opened."""

    def pieces(self, selection: Selection, order: tuple[int, ...]) -> Iterator[Piece]:
        """Yield what may hold the messages that are wanted, by first time."""

    def close(self) -> None:
        """Give up what was opened for it; a second call does nothing."""


class ChunkedMember:
    """A file made of chunks."""

    def __init__(self, file: ChunkedFile, contents: Contents, summary: RecordingSummary | None = None) -> None:
        self._contents = contents
        self.summary = summary
        self._file = file

    @property
    def contents(self) -> Contents:
        """What it says of itself; the span by its message indexes once the index was seen to be wrong."""
        check = self._file.check
        if check is None or check.span is None:
            return self._contents
        return replace(self._contents, start_ns=check.span[0], end_ns=check.span[1])

    def pieces(self, selection: Selection, order: tuple[int, ...]) -> Iterator[Piece]:
        """Yield the chunks that may hold the messages that are wanted, by first time."""
        return pieces_of(self._file, selection, order)

    def doubt_index(self) -> None:
        """State that the file's index was seen to be wrong."""
        if self._file.check is not None:
            self._file.check.doubt()

    def close(self) -> None:
        """Do nothing: whoever opened the source closes it."""


MCAP = ChunkFormat(
    mcap_chunks.open_chunk,
    mcap_chunks.parse_messages,
    salvage_mcap,
    mcap_chunks.read_message_index,
)
_BAG = ChunkFormat(
    bag_chunks.open_chunk,
    bag_chunks.parse_messages,
    salvage_bag,
    bag_chunks.read_message_index,
)


def check_cost(source: Source, most_bytes: int | None, why: str) -> None:
    """Make sure that a file may be read whole; `most_bytes` None: whatever its size.

    Raises:
        TooCostly: it has more bytes.
    """
    if most_bytes is not None and source.size_bytes > most_bytes:
        raise TooCostly(source.name, source.size_bytes, why)


def open_mcap(
    source: Source, noticed: Noticed, *, message_compression: str = "", most_bytes: int | None = None
) -> ChunkedMember:
    """Open an MCAP by its index; one without is read once from end to end, and what is broken in it is noted.

    Raises:
        TooCostly: it would have to be read whole, and has more than `most_bytes`.
        SourceError: as `Source.read`.
    """
    index, summary = _mcap_index(source, noticed, most_bytes)
    channels = index.definitions.resolve(message_compression)
    check = None
    if summary is None:
        check = IndexCheck(source, index.table, noticed, mcap_chunks.read_message_index)
        if _contradicts_itself(index.table, None if index.unreadable else (index.start_ns, index.end_ns)):
            check.doubt()
            check.settle()
    start_ns, end_ns = (index.start_ns, index.end_ns) if index.message_count is not None else _span(index)
    contents = Contents(channels, index.counts, index.message_count, start_ns, end_ns)
    file = ChunkedFile(source, MCAP, index.table, channels, noticed, check=check)
    return ChunkedMember(file, contents, summary)


def open_bag(source: Source, noticed: Noticed, *, most_bytes: int | None = None) -> ChunkedMember:
    """Open a ROS 1 bag by its index; one without is read once from end to end, and what is broken in it is noted.

    Raises:
        TooCostly: it would have to be read whole, and has more than `most_bytes`.
        SourceError: as `Source.read`.
    """
    summary = None
    try:
        index = reading_index.read_index(source)
    except NotIndexed as refusal:
        check_cost(source, most_bytes, str(refusal))
        noticed.add(refusal.code, source.name, str(refusal))
        index, summary = reading_index.rebuild_index(source, noticed)
    rows, check = index.table.rows, None
    if summary is None:
        check = IndexCheck(source, index.table, noticed, bag_chunks.read_message_index)
        if _contradicts_itself(index.table, None):
            check.doubt()
            check.settle()
    start_ns = min(rows.column(Row._fields.index("first_ns")), default=None)
    end_ns = max(rows.column(Row._fields.index("last_ns")), default=None)
    contents = Contents(index.channels, index.counts, sum(index.counts.values()), start_ns, end_ns)
    file = ChunkedFile(source, _BAG, index.table, index.channels, noticed, check=check)
    return ChunkedMember(file, contents, summary)


def _contradicts_itself(table: ChunkTable, span: tuple[int | None, int | None] | None) -> bool:
    """Say whether the times of chunks cannot be true. `span`: of all messages, as the statistics say; None: unknown."""
    firsts, lasts = (table.rows.column(Row._fields.index(name)) for name in ("first_ns", "last_ns"))
    if any(map(gt, firsts, lasts)):
        return True
    if span is None or None in span or not firsts:
        return False
    sizes = table.rows.column(Row._fields.index("uncompressed_bytes"))
    filled = [first for first, size in zip(firsts, sizes, strict=True) if size]
    return span != (min(filled, default=span[0]), max(lasts))


def _mcap_index(source: Source, noticed: Noticed, most_bytes: int | None) -> tuple[McapIndex, RecordingSummary | None]:
    try:
        return read_index(source), None
    except NotIndexed as refusal:
        check_cost(source, most_bytes, str(refusal))
        if refusal.is_problem:
            noticed.add(refusal.code, source.name, str(refusal))
        return rebuild_index(source, noticed)


def _span(index: McapIndex) -> tuple[int | None, int | None]:
    rows = [row for row in index.table.rows if row.uncompressed_bytes and row.start not in index.unreadable]
    if not rows:
        return None, None
    return min(row.first_ns for row in rows), max(row.last_ns for row in rows)
