"""Scans files made of chunks (MCAP, ROS 1 bag) from the first byte to the last, and counts messages by their index.

A scan holds one chunk of at most `MAX_CHUNK_BYTES` (larger ones are left out) and no messages. It continues behind
damage: behind a chunk that cannot be read, or, where the records themselves break off, at the next byte where a record
can begin. It measures what it leaves out.
"""

from __future__ import annotations

import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, TypeVar

from kleinkram.recordings import chunk_table, scanned_messages
from kleinkram.recordings.chunk_index_check import ChunkClaim, ChunkMessages, IndexFaults, wrong_times
from kleinkram.recordings.chunk_reader import ChunkedMember, ChunkFormat, FileGap, JoinedGaps, SalvagedMessages
from kleinkram.recordings.chunk_table import ChunkHead, ChunkTable, ChunkTableBuilder, Row
from kleinkram.recordings.compression import decompress, decompress_beginning, unreadable_chunk, without_zero_tail
from kleinkram.recordings.damage_report import DamageReport, IndexedChunk, ProblemLog
from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.formats.base import MemberContents
from kleinkram.recordings.limits import MAX_CHUNK_BYTES
from kleinkram.recordings.messages import Channel
from kleinkram.recordings.model import RecordingSummary, counted
from kleinkram.recordings.scanned_messages import Batch, LocationKind, MessageCounter, MessageLocation
from kleinkram.recordings.sources import SequentialReader, Source, SourceReader
from kleinkram.recordings.streams import LookaheadStream
from kleinkram.recordings.timeline import ChunkEntries, Timeline

LOOK = 64 * 2**10  # bytes from the start of a record within which its fixed fields and names are

_SEARCH_BYTES = 4 * 2**20

ChannelT = TypeVar("ChannelT", bound=scanned_messages.HasTopic)
FactsT = TypeVar("FactsT", bound="ChunkedFacts[Any]")


@dataclass
class ChunkedFacts(Generic[ChannelT]):
    """Definitions of a file. `table`: chunks, by the index; `index_faults`: errors of the index."""

    channels: dict[int, ChannelT] = field(default_factory=dict)
    table: ChunkTable = field(default_factory=ChunkTable)
    index_faults: IndexFaults = field(default_factory=IndexFaults)
    compression: set[str] = field(default_factory=set)
    names_bytes: int = 0
    definition_bytes: int = 0


@dataclass
class ChunkScan(Generic[FactsT]):
    """The result of a scan. `chunks`: that could be read from end to end."""

    facts: FactsT
    counter: MessageCounter
    losses: DamageReport = field(default_factory=DamageReport)
    chunks: int = 0


class Hole(NamedTuple):
    """Skipped bytes of a chunk's content: [start, end)."""

    start: int
    end: int
    fault: Malformed


class ChunkContents(NamedTuple):
    """The result of reading the records of a chunk.

    `end`: of the chunk, in its content; earlier than that of the content where bytes of the chunk are missing.
    `readable_ranges`: of whole records; they overlap behind a message whose length is wrong. None: all.
    """

    holes: list[Hole]
    end: int
    readable_ranges: scanned_messages.ReadableRanges | None = None


class ChunkScanner(ABC, Generic[FactsT]):
    """Reads the chunks of a file, whole, damaged or cut, and compares them with the index records behind them."""

    def __init__(self, scan: ChunkScan[FactsT], stream: LookaheadStream, builder: ChunkTableBuilder | None) -> None:
        self._scan = scan
        self._stream = stream
        self._builder = builder
        self._chunk: IndexedChunk | None = None
        self._content = b""
        self._actual_chunks = chunk_table.Int64Table(ChunkClaim)

    @abstractmethod
    def _walk(self, raw: bytes, batch: Batch, *, may_end_early: bool = False) -> ChunkContents:
        """Add the messages of a chunk's content to the batch."""

    @abstractmethod
    def _note_holes(self, start: int, head: ChunkHead, contents: ChunkContents, size_bytes: int) -> None:
        """Report what could not be read of a chunk's content, which has `size_bytes`."""

    @abstractmethod
    def _is_followed(self, total: int) -> bool:
        """Return whether a record that is never inside a chunk follows the next `total` bytes."""

    @abstractmethod
    def _reaches_over_chunk(self, after: int) -> bool:
        """Return whether another chunk of this file begins before an offset in the window."""

    @abstractmethod
    def _search(self) -> None:
        """Skip at least one byte, up to the next record."""

    def _is_verified(self, head: ChunkHead) -> bool:
        return self._is_followed(head.record_bytes)

    def _pass_chunk(self, head: ChunkHead) -> None:
        stream, scan = self._stream, self._scan
        start, total, before = stream.position, head.record_bytes, scan.counter.messages
        scan.facts.compression.add(head.compression or "none")
        try:
            if why := unreadable_chunk(head.compression, stored=total, uncompressed=head.uncompressed_bytes):
                raise why
            stream.ahead(total + LOOK)
            if scan.losses.is_search_budget_spent(start) and not self._is_verified(head):
                raise Malformed("chunk", "unverified, after too many bytes were searched without result")
            if head.compression:
                scan.losses.unpack(head.uncompressed_bytes, end=start + total)
            stored = stream.window[stream.at + head.data_start : stream.at + total]
            raw = decompress(head.compression, stored, head.uncompressed_bytes)
            if head.crc and zlib.crc32(raw) != head.crc:
                raise Malformed("chunk", "its checksum is wrong")
        except Malformed as error:
            damage = Malformed(f"chunk at byte {start}", error.message, certain=error.certain)
            self._skip_damaged_chunk(head, damage)
            return
        batch = Batch(scan.facts.channels)
        contents = self._walk(raw, batch, may_end_early=not head.compression)
        location = MessageLocation(LocationKind.chunk, start, total, len(raw), contents.readable_ranges)
        self._count(batch, location, stored=head.stored_bytes)
        self._note_holes(start, head, contents, len(raw))
        stream.advance(total if contents.end == len(raw) else head.data_start + contents.end)
        self._content = raw
        is_complete = not contents.holes
        scan.chunks += is_complete
        scan.losses.chunks += not is_complete
        self._chunk = IndexedChunk(start, scan.counter.messages - before, damaged=not is_complete)
        messages = ChunkMessages()
        messages.add(batch)
        self._note_chunk(start, head, messages if is_complete else None)

    def _count(self, batch: Batch, location: MessageLocation, *, stored: int) -> None:
        """Count messages at a location, of whose content `stored` bytes are in the file."""
        self._scan.counter.learn(self._scan.facts.channels)
        if self._builder is not None:
            self._builder.add(location, batch)
        self._scan.counter.add(batch, stored=stored, uncompressed=location.uncompressed)

    def _note_chunk(self, start: int, head: ChunkHead, messages: ChunkMessages | None) -> None:
        """Note the messages of a chunk (None: not all of them), and compare them with its head."""
        if messages is None:
            self._actual_chunks.append(
                ChunkClaim(start, chunk_table.UNKNOWN, 0, 0, chunk_table.ANY_CHANNEL, chunk_table.UNKNOWN)
            )
            return
        facts, times = self._scan.facts, (messages.first_ns, messages.last_ns)
        channels = facts.table.sets.number(messages.channels)
        known = chunk_table.UNKNOWN if channels == chunk_table.ANY_CHANNEL and messages.channels else messages.messages
        self._actual_chunks.append(ChunkClaim(start, start + head.record_bytes, *times, channels, known))
        if head.times is not None and messages.messages and (wrong := wrong_times(head.times, times)):
            facts.index_faults.note(start, f"its head is wrong: it says that its messages {wrong}")

    def _skip_damaged_chunk(self, head: ChunkHead, damage: Malformed) -> None:
        """Skip a damaged chunk if a record follows it; else search for the next record."""
        stream, scan = self._stream, self._scan
        start, total, before, used = stream.position, head.record_bytes, scan.counter.messages, 0
        scan.losses.chunks += 1
        if (after := stream.at + total) <= len(stream.window):
            zeroed = without_zero_tail(head.compression, bytes(stream.window[stream.at + head.data_start : after]))
            # Bytes of it may be missing, so that its length reaches over the next one.
            is_short = not scan.losses.is_search_budget_spent(start) and self._reaches_over_chunk(after)
            if stream.left > total and (is_short or (zeroed is None and not self._is_followed(total))):
                scan.losses.wasted_bytes += total
                self._resync(damage)
                return
            used = 0 if zeroed is None else self._save_beginning(zeroed, head)
        scan.losses.note(damage)
        self._note_chunk(start, head, None)
        stream.advance(total)
        scan.losses.bytes += total - used
        self._chunk = IndexedChunk(start, scan.counter.messages - before, damaged=True)

    def _read_cut_chunk(self, head: ChunkHead, cut: Cut) -> None:
        """Read what is left of a chunk that reaches beyond the end of the file, or was never finished."""
        stream, scan = self._stream, self._scan
        self._end_chunk()
        scan.facts.compression.add(head.compression or "none")
        scan.losses.chunks += 1
        start, total, before = stream.position, min(head.record_bytes, stream.left), scan.counter.messages
        at_hand = stream.ahead(min(total, MAX_CHUNK_BYTES))
        stored = bytes(stream.window[stream.at + head.data_start : stream.at + at_hand])
        used = self._save_beginning(without_zero_tail(head.compression, stored) or stored, head)
        if start + total == stream.size_bytes:
            self._give_up(cut, total - used)
            return
        stream.advance(total)
        scan.losses.note(cut)
        scan.losses.bytes += total - used
        self._chunk = IndexedChunk(start, scan.counter.messages - before, damaged=True)

    def _save_beginning(self, stored: bytes, head: ChunkHead) -> int:
        """Count the messages of a chunk whose end is missing; return how many of its bytes are used."""
        scan, max_bytes = self._scan, min(head.uncompressed_bytes, MAX_CHUNK_BYTES)
        if head.compression and not scan.losses.may_unpack(max_bytes, end=self._stream.size_bytes):
            return 0
        raw = decompress_beginning(head.compression, stored, max_bytes)
        batch, before, record_bytes = Batch(scan.facts.channels), scan.counter.messages, head.data_start + len(stored)
        contents = self._walk(raw, batch)
        location = MessageLocation(
            LocationKind.cut,
            self._stream.position,
            record_bytes,
            len(raw),
            contents.readable_ranges or ((0, len(raw)),),
        )
        self._count(batch, location, stored=len(stored))
        scan.losses.unverified += scan.counter.messages - before
        followed = len(raw) - sum(hole.end - hole.start for hole in contents.holes)
        return head.data_start + len(stored) * followed // len(raw) if followed else 0

    def _note_index_record(self, messages: int, points_at_messages: Callable[[], bool], fault: str) -> None:
        """Note an index record behind a chunk, the number of messages in it, and whether its offsets are right."""
        if self._chunk is None:
            return
        self._chunk.records += 1
        self._chunk.messages += messages
        if self._content:
            try:
                is_right = points_at_messages()
            except Malformed:
                is_right = False
            if not is_right:
                self._scan.facts.index_faults.note(self._chunk.start, fault)

    def _end_chunk(self) -> None:
        """Compare the last chunk with its index records."""
        if self._chunk is not None:
            self._chunk.compare(self._scan.losses)
            self._chunk, self._content = None, b""

    def _resync(self, damage: Malformed, valid_bytes: int = 0) -> None:
        """Skip damage up to the next record; the first `valid_bytes` are not lost."""
        stream, losses = self._stream, self._scan.losses
        self._end_chunk()
        losses.note(damage)
        losses.messages_are_known = False
        start = stream.position + valid_bytes
        self._search()
        losses.bytes += max(0, stream.position - start)

    def _give_up(self, damage: Malformed, lost: int) -> None:
        """Skip the rest of the file; `lost`: bytes of it that cannot be read."""
        self._scan.losses.note(damage)
        self._scan.losses.bytes += lost
        self._scan.losses.messages_are_known = False
        self._stream.advance(self._stream.left)

    def _drop_undefined(self, where: str, what: str) -> None:
        if undefined := self._scan.counter.finish():
            message = f"{counted(undefined, 'message is', 'messages are')} {what}"
            self._scan.losses.note(Malformed(where, message))
            self._scan.losses.messages += undefined


def search_width(stream: LookaheadStream) -> int:
    """Fill the window; return how many of its next bytes can be the start of a record whose head is in it."""
    at_hand = stream.ahead(_SEARCH_BYTES)
    return at_hand if at_hand == stream.left else at_hand - LOOK


class ChunkIndex(NamedTuple):
    """Message indexes behind a chunk: (channel number, log times, offsets in the content) of each."""

    row: Row
    head: ChunkHead
    entries: Iterable[tuple[int, Sequence[int], Sequence[int]]]


def count_by_index(
    facts: ChunkedFacts[ChannelT], indexes: Iterable[ChunkIndex], timeline: Timeline, losses: DamageReport
) -> None:
    """Count the messages that the indexes of all chunks list, and the chunks that cannot be read."""
    for channel in facts.channels.values():
        timeline.topic(channel.topic)
    watermarks = chunk_table.smallest_to_come(facts.table.rows.column("first_ns"))
    for (row, head, entries), before_ns in zip(indexes, watermarks, strict=True):
        by_topic: dict[str, ChunkEntries] = {}
        messages = ChunkMessages()
        for number, stamps, offsets in entries:
            messages.add_index(number, stamps)
            topic = facts.channels[number].topic
            if known := by_topic.get(topic):
                stamps, offsets = [*known.stamps, *stamps], [*known.offsets, *offsets]
            by_topic[topic] = ChunkEntries(topic, stamps, offsets)
        claim = ChunkClaim(row.start, chunk_table.UNKNOWN, row.first_ns, row.last_ns, row.channels, row.messages)
        facts.index_faults.compare(claim, facts.table.sets.listed(row.channels), messages)
        stored, uncompressed = head.record_bytes, head.uncompressed_bytes
        if why := unreadable_chunk(head.compression, stored=stored, uncompressed=uncompressed):
            losses.skip_chunk(row.start, stored, messages.messages, why)
        else:
            chunk = list(by_topic.values())
            timeline.add_chunk(chunk, uncompressed_bytes=uncompressed, stored_bytes=head.stored_bytes)
        timeline.finish(before_ns)


def open_by_scan(
    source: Source,
    builder: ChunkTableBuilder,
    chunk_format: ChunkFormat,
    channels: dict[int, Channel],
    summary: RecordingSummary,
) -> ChunkedMember:
    """Return a file whose chunks a scan found."""
    builder.close()
    counts = {number: count for number, count in builder.counts.items() if number in channels}
    span = builder.table.span() if counts else (None, None)
    contents = MemberContents(channels, counts, sum(counts.values()), *span, summary.profile)
    return ChunkedMember(source, chunk_format, builder.table, contents, builder.problem_log, summary=summary)


def salvage_by_scan(
    source: Source,
    gaps: Iterable[FileGap],
    magic: bytes,
    scan: Callable[[SequentialReader, ChunkTableBuilder], object],
) -> SalvagedMessages:
    """Scan parts of a file for messages."""
    part = JoinedGaps(source, magic, gaps)
    builder = ChunkTableBuilder(ProblemLog())
    scan(SourceReader(part), builder)
    builder.close()
    return SalvagedMessages(part, builder.table)
