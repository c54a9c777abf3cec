"""Reads the selected messages of a file made of chunks (MCAP, ROS 1 bag), in the order of time, by its chunk table.

Only chunks that may hold selected messages are read. Threads fetch, decompress and check the next ones.
Of a chunk that fails its checksum or cannot be decompressed, what a scan finds in it is read; one larger than
`MAX_CHUNK_BYTES` is left out.
"""

from __future__ import annotations

import heapq
import zlib
from array import array
from bisect import bisect_right
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

from kleinkram.recordings.chunk_index_check import IndexCheck, ReadMessageIndex, contradicts_itself
from kleinkram.recordings.chunk_table import ANY_CHANNEL, ChunkHead, ChunkTable, Int64Table, Row
from kleinkram.recordings.compression import Buffer, decompress, decompress_beginning, unreadable_chunk
from kleinkram.recordings.damage_report import ProblemLog
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.base import MemberContents, OtherRecord, Segment
from kleinkram.recordings.limits import MAX_CHUNK_BYTES, MAX_READ
from kleinkram.recordings.merge_messages import OVERHEAD_BYTES, MessagePiece, MessageRun, merge
from kleinkram.recordings.messages import Block, Channel, Selection
from kleinkram.recordings.model import RecordingSummary
from kleinkram.recordings.scanned_messages import LocationKind
from kleinkram.recordings.sources import ReadAheadTask, Source, read_ahead
from kleinkram.recordings.streams import ByteStream, open_bytes, open_range

MAX_MESSAGE = 64 * 2**20  # bytes of one message; a larger one is left out
MAX_AHEAD = 32 * 2**20  # bytes of chunks that are fetched and decompressed ahead
MAX_SALVAGED = 256 * 2**20  # bytes of damaged chunks, in one iteration, that are searched for what can be saved

_AHEAD_ON_DISK = 8 * 2**20
_MIN_WORKERS = 2
_GROUP_BYTES = 4 * 2**20
_HEAD_BYTES = 4096
_log_time = itemgetter(1)


def _refuse_chunk(stream: ByteStream) -> ChunkHead:
    raise Malformed(f"byte {stream.position}", "this format has no chunks")


@dataclass(frozen=True)
class ChunkFormat:
    """Layout of chunks and messages of one format. The defaults are those of a format without chunks.

    `parse_messages` returns the messages of some channels in a chunk's content, in file order; `salvage` finds messages
    in parts of a file, such as a damaged chunk. `find_other_records` yields the attachments and metadata records of a
    file that are whole, and a sentence about each that is not.
    """

    parse_messages: Callable[[Buffer, Mapping[int, Channel], Selection], Block]
    open_chunk: Callable[[ByteStream], ChunkHead] = _refuse_chunk
    salvage: Salvage = lambda source, _gaps, _channels: SalvagedMessages(JoinedGaps(source, b"", ()), ChunkTable())
    read_message_index: ReadMessageIndex = lambda _source, _row: None
    find_other_records: FindOtherRecords = lambda _source, _table, _opcodes: iter(())


FindOtherRecords = Callable[[Source, ChunkTable, Container[int]], Iterator[OtherRecord | Malformed]]
Loaded = Buffer | Malformed  # the content of a chunk, or why it cannot be read


class ChunkedMember:
    """A file made of chunks.

    `summary`: if it was scanned to be opened. `is_part`: of a damaged chunk. `with_index_check`: the table comes from
    the file's own index, which may be wrong. `claimed_span`: by the statistics. `max_ahead`: bytes of chunks that one
    iteration fetches and decompresses ahead; lower it where several files are read at the same time. `first_ahead`: at
    the start of an iteration, after which it doubles; set it to `max_ahead` where all that is selected will be read.
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
        is_part: bool = False,
        with_index_check: bool = False,
        claimed_span: tuple[int | None, int | None] = (None, None),
    ) -> None:
        self.source, self.format, self.table, self.problem_log = source, chunk_format, table, problem_log
        self.summary, self.is_part, self._contents = summary, is_part, contents
        self.max_ahead = MAX_AHEAD if getattr(source, "parallel_reads", 1) > 1 else _AHEAD_ON_DISK
        self.first_ahead = 0
        self.check: IndexCheck | None = None
        if with_index_check:
            self.check = IndexCheck(source, table, problem_log, chunk_format.read_message_index)
            if contradicts_itself(table, claimed_span):
                self.check.mark_wrong()
                self.check.complete()

    @property
    def contents(self) -> MemberContents:
        """The content by the index; if that is wrong, with the span by its message indexes."""
        if self.check is None or self.check.span is None:
            return self._contents
        return replace(self._contents, start_ns=self.check.span[0], end_ns=self.check.span[1])

    def pieces(self, selection: Selection, order: tuple[int, ...]) -> Iterator[MessagePiece]:
        """Yield the chunks that may hold selected messages, by first time. Open them in this order."""
        reader = _ChunkReader(self, selection)
        yield from reader.pieces(reader.select(), order)

    def segments(self, selection: Selection, file_number: int) -> Iterator[Segment]:
        """Yield the chunks that may hold selected messages, by first time."""
        numbers = _ChunkReader(self, selection).select()
        topics = {number: channel.topic for number, channel in self.contents.channels.items()}
        in_sets = [
            None if number == ANY_CHANNEL else frozenset(topics[member] for member in members if member in topics)
            for number, members in enumerate(self.table.sets.members)
        ]
        for number in numbers:
            row = self.table.rows[number]
            yield Segment(row.first_ns, row.last_ns, row.length, in_sets[row.channels], (file_number, number))

    def segment_pieces(self, segment: Segment, selection: Selection) -> Iterator[MessagePiece]:
        """Yield one chunk."""
        return _ChunkReader(self, selection).pieces([segment.order[1]], segment.order)


class _ChunkReader:
    def __init__(self, file: ChunkedMember, selection: Selection) -> None:
        self._file = file
        self._channels = file.contents.select(selection)
        self._selection = selection
        self._salvage_left = MAX_SALVAGED
        self._searched = False
        self._numbers = array("Q")
        self._is_selection_sure = True

    def select(self) -> array[int]:
        """Return the numbers of the chunks that may hold selected messages, by their first time."""
        file, channels, check = self._file, frozenset(self._channels), self._file.check
        if check is not None:
            check.check_before_selection()
        self._numbers = file.table.select(self._selection, channels)
        if check is not None and channels and not self._numbers:
            check.check_after_empty_selection()
            self._numbers = file.table.select(self._selection, channels)
        self._is_selection_sure = check is None or check.is_done
        return self._numbers

    def pieces(self, numbers: Iterable[int], order: tuple[int, ...]) -> Iterator[MessagePiece]:
        """Yield chunks. Open them in this order."""
        selection, loaded = self._selection, self.load_ahead(numbers)
        for number in numbers:
            row = self._file.table.rows[number]

            def open_next(row: Row = row) -> MessageRun:
                return self._with_missed_chunks(row, self.open(row, next(loaded)))

            def read_again(row: Row = row) -> Block:
                return self.read_again(row)

            first_ns = max(row.first_ns, selection.start_ns)
            yield MessagePiece(
                first_ns, (*order, number), open_next, read_again if row.kind == LocationKind.chunk else None
            )

    def _with_missed_chunks(self, row: Row, run: MessageRun) -> MessageRun:
        """Return the messages of a chunk, with those of chunks that a wrong index had left unselected."""
        check = self._file.check
        if check is None or self._is_selection_sure:
            return run
        check.complete()
        if not check.is_done:
            return run
        self._is_selection_sure = True
        selected = set(self._numbers)
        missed = [n for n in self._file.table.select(self._selection, frozenset(self._channels)) if n not in selected]
        if not missed:
            return run
        own = MessagePiece(row.first_ns, (0,), lambda: run)
        pieces = heapq.merge([own], self.pieces(missed, (1,)), key=lambda piece: piece.first_ns)
        return MessageRun([], 0, merge(pieces, self._file.problem_log.note_late))

    def load_ahead(self, numbers: Iterable[int]) -> Iterator[Loaded]:
        parallel: int = getattr(self._file.source, "parallel_reads", 1)
        tasks, file = self._tasks(numbers, together=parallel > 1), self._file
        workers = max(_MIN_WORKERS, parallel)
        for group in read_ahead(tasks, workers=workers, max_bytes=file.max_ahead, first_bytes=file.first_ahead):
            yield from group

    def _tasks(self, numbers: Iterable[int], *, together: bool) -> Iterator[ReadAheadTask[list[Loaded]]]:
        """Yield what to fetch; over a network, adjacent chunks are fetched together."""
        group: list[Row] = []
        size, previous, may_join = 0, -1, together and self._file.first_ahead > 0
        group_bytes = min(_GROUP_BYTES, self._file.max_ahead // 4)
        for number in numbers:
            row = self._file.table.rows[number]
            if group and not (may_join and number == previous + 1 and row.start - group[0].start < group_bytes):
                yield ReadAheadTask(size, partial(self._load_group, group))
                may_join = together
                group, size = [], 0
            group.append(row)
            size += min(row.length + row.uncompressed_bytes, 2 * MAX_CHUNK_BYTES)
            previous = number
        if group:
            yield ReadAheadTask(size, partial(self._load_group, group))

    def _load_group(self, group: list[Row]) -> list[Loaded]:
        first = group[0]
        span = max(row.start + row.length for row in group) - first.start
        if len(group) == 1 or span > MAX_READ:
            return [self._load(row) for row in group]
        data = memoryview(self._file.source.read(first.start, span))
        return [self._content_of(row, data[row.start - first.start :][: row.length]) for row in group]

    def _load(self, row: Row) -> Loaded:
        start, end = row.start, row.start + row.length
        if row.kind == LocationKind.records and row.length > MAX_MESSAGE:
            return Malformed(f"byte {start}", f"a message of {row.length} bytes; at most {MAX_MESSAGE} are read")
        if row.kind == LocationKind.chunk and row.length > MAX_CHUNK_BYTES:
            return unreadable_chunk("", stored=row.length, uncompressed=0) or b""
        read = self._file.source.read
        if row.length <= MAX_READ:
            return self._content_of(row, read(start, row.length))
        return self._content_of(row, b"".join(read(at, min(MAX_READ, end - at)) for at in range(start, end, MAX_READ)))

    def _content_of(self, row: Row, data: Buffer) -> Loaded:
        """Return the content of a row: records as they are, a chunk decompressed."""
        if row.kind == LocationKind.records:
            return data
        try:
            head = self._file.format.open_chunk(open_bytes(bytes(data[:_HEAD_BYTES]), row.start))
            stored = memoryview(data)[head.data_start : head.record_bytes]
            if row.kind == LocationKind.cut:
                max_bytes = min(head.uncompressed_bytes, MAX_CHUNK_BYTES)
                return decompress_beginning(head.compression, bytes(stored), max_bytes)
            if why := unreadable_chunk(head.compression, stored=row.length, uncompressed=head.uncompressed_bytes):
                return why
            content = decompress(head.compression, stored, head.uncompressed_bytes)
        except Malformed as error:
            return error
        if head.crc and zlib.crc32(content) != head.crc:
            return Malformed(f"byte {row.start}", "its checksum is wrong")
        return content

    def open(self, row: Row, loaded: Loaded) -> MessageRun:
        if isinstance(loaded, Malformed):
            return self._salvaged(row, loaded)
        try:
            messages = self._parse(row, loaded)
        except Malformed as error:
            return self._salvaged(row, error)
        return MessageRun(messages, len(loaded) + OVERHEAD_BYTES * len(messages))

    def read_again(self, row: Row) -> Block:
        loaded = self._load(row)
        if isinstance(loaded, Malformed):
            return []
        try:
            return self._parse(row, loaded)
        except Malformed:
            return []  # it was complete when it was read before: the file has changed

    def _salvaged(self, row: Row, damage: Malformed) -> MessageRun:
        """Scan a damaged chunk, or the file where the index lists a chunk that is not there."""
        file = self._file
        gaps: Iterable[FileGap] = []
        if not file.is_part and row.kind != LocationKind.records:
            is_there = (
                row.kind == LocationKind.cut or end_of_chunk(file.source, row, file.format.open_chunk) is not None
            )
            gaps = [FileGap(row.start, row.end)] if is_there else self._search_unlisted_ranges()
        size = sum(gap.end - gap.start for gap in gaps)
        contents = file.contents
        saved = file.format.salvage(file.source, gaps, contents.channels) if 0 < size <= self._salvage_left else None
        where = f"{'messages' if row.kind == LocationKind.records else 'chunk'} at byte {row.start}"
        if saved is None or not saved.table.rows:
            file.problem_log.add("damaged", where, f"left out: {damage.message}")
            return MessageRun([], 0)
        self._salvage_left -= size
        file.problem_log.add("damaged", where, f"only what could be saved of it is read: {damage.message}")
        inside = ChunkedMember(saved.part, file.format, saved.table, contents, file.problem_log, is_part=True)
        return MessageRun([], 0, self._check_blocks(row, merge(inside.pieces(self._selection, ()))))

    def _search_unlisted_ranges(self) -> Iterable[FileGap]:
        """Return the ranges in which unlisted chunks may be; nothing at the second call."""
        if self._searched:
            return []
        self._searched = True
        file = self._file
        message = "its index lists chunks that are not there; the space between the others is read instead"
        file.problem_log.add("index-damaged", file.source.name, message)
        return unlisted_ranges(file.source, file.table.rows, file.format.open_chunk)

    def _check_blocks(self, row: Row, blocks: Iterator[Block]) -> Iterator[Block]:
        for block in blocks:
            self._compare_times(row, block)
            yield block

    def _parse(self, row: Row, content: Buffer) -> Block:
        parse, messages = self._file.format.parse_messages, Block()
        readable_ranges = self._file.table.readable_ranges.get(row.start, ((0, len(content)),))
        for start, end in readable_ranges:
            messages += parse(content[start:end], self._channels, self._selection)
        messages.sort(key=_log_time)
        self._compare_times(row, messages)
        return messages

    def _compare_times(self, row: Row, messages: Block) -> None:
        """Report a chunk with messages outside the times in the index: it may have been opened too late for them."""
        if not messages:
            return
        wrong = []
        if messages[-1].log_time_ns > row.last_ns:
            wrong.append("it holds later messages than the index says")
        if messages[0].log_time_ns < row.first_ns:
            late = "those that came too late to be in order are left out"
            wrong.append(f"it holds earlier messages than the index says; {late}")
        for message in wrong:
            self._file.problem_log.add("index-damaged", f"chunk at byte {row.start}", message)
        if wrong and self._file.check is not None:
            self._file.check.mark_wrong()


class FileGap(NamedTuple):
    """A range of a file: [start, end)."""

    start: int
    end: int


class JoinedGaps:
    """Ranges of a source, joined behind the magic of its format: a `Source` that can be scanned."""

    path: Path | None = None

    def __init__(self, source: Source, magic: bytes, gaps: Iterable[FileGap]) -> None:
        self.name = source.name
        self._source = source
        self._magic = magic
        self._starts = array("Q")
        self._ends = array("Q", [len(magic)])
        for start, end in gaps:
            start, end = max(start, len(magic)), min(end, source.size_bytes)
            if start < end:
                self._starts.append(start)
                self._ends.append(self._ends[-1] + end - start)
        self.size_bytes = self._ends[-1]

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes at an offset of the joined ranges."""
        data = self._magic[offset : offset + length]
        while len(data) < length:
            at = offset + len(data)
            number = bisect_right(self._ends, at)
            size = min(length - len(data), self._ends[number] - at)
            data += self._source.read(self._starts[number - 1] + at - self._ends[number - 1], size)
        return data


@dataclass(frozen=True)
class SalvagedMessages:
    """Where a scan found messages in part of a file."""

    part: JoinedGaps
    table: ChunkTable


Salvage = Callable[[Source, Iterable[FileGap], Mapping[int, Channel]], SalvagedMessages]
OpenChunk = Callable[[ByteStream], ChunkHead]


def end_of_chunk(source: Source, row: Row, open_chunk: OpenChunk) -> int | None:
    """Return where the chunk of a row ends; None if there is no chunk, or it does not fit into the row."""
    stream = open_range(source, row.start, row.end, window=_HEAD_BYTES)
    try:
        head = open_chunk(stream)
    except Malformed:
        return None
    end = stream.position + head.stored_bytes
    return end if end <= row.end else None


def unlisted_ranges(source: Source, rows: Int64Table[Row], open_chunk: OpenChunk) -> Int64Table[FileGap]:
    """Return the ranges of a file outside of the chunks that are where the index lists them; reads the head of each."""
    gaps, at = Int64Table(FileGap), 0
    for row in rows:
        end = end_of_chunk(source, row, open_chunk) if row.start >= at else None
        if end is not None:
            gaps.append(FileGap(at, row.start))
            at = end
    gaps.append(FileGap(at, source.size_bytes))
    return gaps
