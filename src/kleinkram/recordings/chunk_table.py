"""Tables of the chunks of a file, by its index or by a scan: 8 bytes a cell, for millions of chunks."""

from __future__ import annotations

from array import array
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from operator import le
from typing import Generic, NamedTuple, TypeVar

from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_CHUNKS, WINDOW
from kleinkram.recordings.messages import Selection
from kleinkram.recordings.scanned_messages import BATCH_STRIDE, Batch, LocationKind, MessageLocation, ReadableRanges

MAX_SET_BYTES = 16 * 2**20
_MAX_MESSAGES_OF_ROW = 8192
_MAX_RANGES = 200_000
_NO_TIME = (2**64 - 1, 0)

ANY_CHANNEL = 0  # the set of a chunk of which is not known who is in it
UNKNOWN = 2**64 - 1  # a number that the index of this format does not state


class ChannelSets:
    """Sets of channels. A set that many chunks share is stored once."""

    def __init__(self) -> None:
        self.members: list[frozenset[int]] = [frozenset()]
        self._numbers: dict[frozenset[int], int] = {}
        self._bytes = 0

    def number(self, channel_ids: Iterable[int]) -> int:
        """Return the number of a set of channels; `ANY_CHANNEL` once the sets take too much memory."""
        members = frozenset(channel_ids)
        number = self._numbers.get(members)
        if number is None:
            self._bytes += 200 + 64 * len(members)
            if self._bytes > MAX_SET_BYTES:
                return ANY_CHANNEL
            number = self._numbers[members] = len(self.members)
            self.members.append(members)
        return number

    def listed(self, number: int) -> frozenset[int] | None:
        """Return the channels of a set; None if unknown."""
        return None if number == ANY_CHANNEL else self.members[number]


RowT = TypeVar("RowT", bound=NamedTuple)


class Int64Table(Generic[RowT]):
    """Rows of unsigned 64-bit numbers; `row_type`: a NamedTuple of integers."""

    def __init__(self, row_type: type[RowT]) -> None:
        self._row_type = row_type
        self._columns = len(row_type._fields)
        self._cells = array("Q")

    def __len__(self) -> int:
        return len(self._cells) // self._columns

    def __getitem__(self, number: int) -> RowT:
        at = number * self._columns
        return self._row_type._make(self._cells[at : at + self._columns])

    def __iter__(self) -> Iterator[RowT]:
        return (self[number] for number in range(len(self)))

    def append(self, row: RowT) -> None:
        """Add a row."""
        if len(self) >= MAX_CHUNKS:
            raise Malformed("index", f"more than {MAX_CHUNKS} chunks", certain=False)
        size = len(self._cells)
        try:
            self._cells.extend(row)
        except OverflowError:
            del self._cells[size:]
            raise Malformed("index", "a chunk lies beyond any possible file size") from None

    def replace(self, number: int, row: RowT) -> None:
        """Replace a row."""
        at = number * self._columns
        self._cells[at : at + self._columns] = array("Q", row)

    def pop(self) -> None:
        """Remove the last row, if there is one."""
        del self._cells[-self._columns :]

    def column(self, name: str) -> array[int]:
        """Return one column."""
        return self._cells[self._row_type._fields.index(name) :: self._columns]

    def sort(self) -> None:
        """Sort the rows by their first column."""
        keys = self._cells[0 :: self._columns]
        if all(map(le, keys, keys[1:])):
            return
        ordered = array("Q")
        for number in sorted(range(len(self)), key=keys.__getitem__):
            ordered.extend(self[number])
        self._cells = ordered


def smallest_to_come(values: array[int]) -> Iterator[int | None]:
    """Yield, for each value, the smallest of the later ones; None for the last."""
    smallest = array("Q")
    for value in reversed(values):
        smallest.append(min(value, smallest[-1]) if smallest else value)
    smallest.reverse()
    yield from smallest[1:]
    if smallest:
        yield None


class ChunkHead(NamedTuple):
    """The fields of a chunk record before its stored bytes, which begin `data_start` bytes into the record.

    `compression`: empty for none. `crc`: of the uncompressed bytes; 0: none. `times`: first and last log time; None
    where the format does not say. `is_unfinished`: its lengths were never filled in.
    """

    compression: str
    uncompressed_bytes: int
    crc: int
    data_start: int
    stored_bytes: int
    times: tuple[int, int] | None = None
    is_unfinished: bool = False

    @property
    def record_bytes(self) -> int:
        """Bytes of the whole record."""
        return self.data_start + self.stored_bytes


class Row(NamedTuple):
    """A chunk, or records outside of chunks: [start, start + length), with inclusive times.

    `end`: behind its message indexes. `kind`: of `MessageLocation`. `uncompressed_bytes`: maybe a guess. `stored_bytes`
    and `messages` are `UNKNOWN` where the index does not state them.
    """

    start: int
    length: int
    end: int
    first_ns: int
    last_ns: int
    kind: int
    channels: int
    uncompressed_bytes: int
    stored_bytes: int = UNKNOWN
    messages: int = UNKNOWN


@dataclass
class ChunkTable:
    """The chunks of one file, in file order. `readable_ranges`: of the content of damaged chunks, by their start."""

    rows: Int64Table[Row] = field(default_factory=lambda: Int64Table(Row))
    readable_ranges: dict[int, ReadableRanges] = field(default_factory=dict)
    sets: ChannelSets = field(default_factory=ChannelSets)

    def known_channels(self) -> frozenset[int]:
        """Return all channels that are known to be in some chunk."""
        return frozenset().union(*self.sets.members)

    def span(self, without: Container[int] = ()) -> tuple[int | None, int | None]:
        """Return first and last time of all chunks, except empty ones and those that start at offsets in `without`."""
        rows = [row for row in self.rows if row.uncompressed_bytes and row.start not in without]
        first_ns = min((row.first_ns for row in rows), default=None)
        return first_ns, max((row.last_ns for row in rows), default=None)

    def select(self, selection: Selection, channel_ids: frozenset[int]) -> array[int]:
        """Return the numbers of the rows that may hold selected messages of channels, by first time and offset."""
        hits = [
            number == ANY_CHANNEL or bool(members & channel_ids) for number, members in enumerate(self.sets.members)
        ]
        start_ns, end_ns = selection.start_ns, selection.end_ns
        firsts, lasts, sets = map(self.rows.column, ("first_ns", "last_ns", "channels"))
        numbers = array(
            "Q",
            (
                number
                for number, (first_ns, last_ns, members) in enumerate(zip(firsts, lasts, sets, strict=True))
                if first_ns < end_ns and last_ns >= start_ns and hits[members]
            ),
        )
        if any(firsts[after] < firsts[before] for before, after in pairwise(numbers)):
            numbers = array("Q", sorted(numbers, key=firsts.__getitem__))
        return numbers


class ChunkTableBuilder:
    """Makes a table of chunks from the locations of messages that a scan finds, and counts messages by channel."""

    def __init__(self, problem_log: ProblemLog) -> None:
        self.counts: dict[int, int] = {}
        self.problem_log = problem_log
        self.table = ChunkTable()
        self._location: MessageLocation | None = None
        self._channels: set[int] = set()
        self._first_ns, self._last_ns = _NO_TIME
        self._messages = 0
        self._counts_here: dict[int, int] = {}
        self._range_count = 0

    def add(self, location: MessageLocation, batch: Batch) -> None:
        """Note messages at a location. May be called several times for one location."""
        if not any(batch.values()):
            return
        if self._location is None or not self._joins(location):
            self.close()
            self._location = location
        elif location.kind == LocationKind.records:
            length = self._location.length + location.length
            self._location = self._location._replace(length=length, uncompressed=length)
        seen: set[int] = set()
        for number, rows in batch.items():
            stamps = rows[0::BATCH_STRIDE]
            if not stamps:
                continue
            self._channels.add(number)
            if id(rows) in seen:  # channels of one topic share it
                continue
            seen.add(id(rows))
            self._counts_here[number] = self._counts_here.get(number, 0) + len(stamps)
            self._messages += len(stamps)
            self._first_ns, self._last_ns = min(self._first_ns, min(stamps)), max(self._last_ns, max(stamps))

    def close(self) -> None:
        """End the current row, if there is one."""
        location = self._location
        if location is not None and self._remembers(location):
            kind, start, length, uncompressed, readable_ranges = location
            members = self.table.sets.number(self._channels)
            times = self._first_ns, self._last_ns
            self.table.rows.append(Row(start, length, start + length, *times, kind, members, uncompressed))
            if readable_ranges is not None:
                self.table.readable_ranges[start] = readable_ranges
        for number, count in self._counts_here.items():
            self.counts[number] = self.counts.get(number, 0) + count
        self._location, self._messages = None, 0
        self._channels, self._counts_here = set(), {}
        self._first_ns, self._last_ns = _NO_TIME

    def _joins(self, location: MessageLocation) -> bool:
        known = self._location
        if known is None or known.kind != location.kind:
            return False
        if location.kind != LocationKind.records:
            return known.start == location.start
        fits = known.length + location.length <= WINDOW and self._messages < _MAX_MESSAGES_OF_ROW
        return fits and known.start + known.length == location.start

    def _remembers(self, location: MessageLocation) -> bool:
        """Return whether there is room for another location. Bounds the memory for files full of damage."""
        self._range_count += len(location.readable_ranges or ())
        if self._range_count <= _MAX_RANGES and len(self.table.rows) < MAX_CHUNKS:
            return True
        self.problem_log.add(
            "too-damaged", f"byte {location.start}", "left out: the file has too many locations to remember"
        )
        return False
