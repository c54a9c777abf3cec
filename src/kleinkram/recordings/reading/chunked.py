"""One file made of chunks (MCAP, ROS 1 bag): from its table of chunks to messages in the order of time.

Only chunks that may hold what is wanted are read. The next ones are fetched, decompressed and checked meanwhile, as
far ahead as `do_ahead` allows. A chunk that fails its checksum or cannot be decompressed is named in the problems, and
what a scan finds in it is read. One larger than `MAX_CHUNK_HELD` goes through a temporary file.
"""

from __future__ import annotations

import heapq
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import itemgetter

from kleinkram.recordings.decompress import Buffer, decompress, decompress_beginning, open_decompressed
from kleinkram.recordings.errors import Malformed, SourceError
from kleinkram.recordings.limits import MAX_AT_ONCE, MAX_READ, WINDOW
from kleinkram.recordings.listening import CHUNK, CUT, RECORDS
from kleinkram.recordings.reading.ahead import Job, do_ahead
from kleinkram.recordings.reading.chunk_table import ChunkHead, ChunkTable, Row
from kleinkram.recordings.reading.index_check import IndexCheck, ReadMessageIndex
from kleinkram.recordings.reading.merging import OVERHEAD_BYTES, Block, Piece, Run, merge
from kleinkram.recordings.reading.model import Channel, Selection
from kleinkram.recordings.reading.noticing import Noticed
from kleinkram.recordings.reading.salvaging import Gap, Salvage, end_of_chunk, unlisted
from kleinkram.recordings.reading.unpacking import limited
from kleinkram.recordings.rosbag2.spool import TooLarge, temporary_copy
from kleinkram.recordings.sources import FileSource, Source
from kleinkram.recordings.stream import ForwardStream, open_bytes, open_range

MAX_MESSAGE = 64 * 2**20
"""Bytes of one message; a larger one is left out."""

MAX_CHUNK_HELD = MAX_AT_ONCE
"""Bytes of a chunk, decompressed, that are held in memory; a larger one is spooled to a temporary file."""

MAX_AHEAD = 32 * 2**20
"""Bytes of chunks that are fetched and decompressed ahead."""

MAX_SALVAGED = 256 * 2**20
"""Bytes of damaged chunks, in one iteration, that are searched for what can be saved."""

_AHEAD_ON_DISK = 8 * 2**20
_LEAST_WORKERS = 2
_GROUP_BYTES = 4 * 2**20
_HEAD_BYTES = 4096
_log_time = itemgetter(1)


@dataclass(frozen=True)
class ChunkFormat:
    """How one format writes chunks and messages.

    Attributes:
        open_chunk: reads a chunk's record up to its stored bytes.
        parse_messages: (content of a chunk, wanted channels, selection) -> their messages in the order they stand.
        table_of_records: where messages stand in the content of a chunk that is too large to hold.
        salvage: where messages stand in parts of a file, such as a chunk that is damaged.
        read_message_index: what the message index behind a chunk lists.
    """

    open_chunk: Callable[[ForwardStream], ChunkHead]
    parse_messages: Callable[[Buffer, Mapping[int, Channel], Selection], Block]
    table_of_records: Callable[[ForwardStream], ChunkTable]
    salvage: Salvage
    read_message_index: ReadMessageIndex


@dataclass(frozen=True)
class ChunkedFile:
    """A file, where its chunks are, and who writes in them.

    Attributes:
        is_part: it is part of a damaged or large chunk, of which no more can be saved.
        check: whether the table may be believed; None: it was not made of the file's own index.
    """

    source: Source
    format: ChunkFormat
    table: ChunkTable
    channels: Mapping[int, Channel]
    noticed: Noticed
    is_part: bool = False
    check: IndexCheck | None = None


Loaded = Buffer | Malformed | None
"""The content of a chunk; why there is none; None: it is too large to be held."""


def pieces_of(file: ChunkedFile, selection: Selection, order: tuple[int, ...]) -> Iterator[Piece]:
    """Yield the chunks that may hold what is wanted, by their first time, to be opened in this order."""
    wanted = {
        number: channel
        for number, channel in file.channels.items()
        if selection.topics is None or channel.topic in selection.topics
    }
    reader = _Reader(file, wanted, selection)
    yield from reader.pieces(reader.select(), order)


class _Reader:
    def __init__(self, file: ChunkedFile, wanted: Mapping[int, Channel], selection: Selection) -> None:
        self._file = file
        self._wanted = wanted
        self._selection = selection
        self._salvage_left = MAX_SALVAGED
        self._searched = False
        self._numbers = array("Q")
        self._is_selection_sure = True

    def select(self) -> array[int]:
        """Return the numbers of the chunks that may hold what is wanted, by their first time."""
        file, wanted, check = self._file, frozenset(self._wanted), self._file.check
        if check is not None:
            check.before_selecting()
        self._numbers = file.table.select(self._selection, wanted)
        if check is not None and wanted and not self._numbers:
            check.when_nothing_fits()
            self._numbers = file.table.select(self._selection, wanted)
        self._is_selection_sure = check is None or check.is_done
        return self._numbers

    def pieces(self, numbers: Iterable[int], order: tuple[int, ...]) -> Iterator[Piece]:
        """Yield chunks, to be opened in this order."""
        selection, loaded = self._selection, self.load_ahead(numbers)
        for number in numbers:
            row = self._file.table.rows[number]

            def open_next(row: Row = row) -> Run:
                return self._with_missed(row, self.open(row, next(loaded)))

            def read_again(row: Row = row) -> Block:
                return self.read_again(row)

            is_small = row.kind == CHUNK and row.uncompressed_bytes <= MAX_CHUNK_HELD
            yield Piece(
                max(row.first_ns, selection.start_ns), (*order, number), open_next, read_again if is_small else None
            )

    def _with_missed(self, row: Row, run: Run) -> Run:
        """Return the messages of a chunk; where the index was seen to be wrong meanwhile, here or by another reader of
        the file, with those of the chunks that were not selected for that reason.
        """
        check = self._file.check
        if check is None or self._is_selection_sure:
            return run
        check.settle()
        if not check.is_done:
            return run
        self._is_selection_sure = True
        selected = set(self._numbers)
        missed = [n for n in self._file.table.select(self._selection, frozenset(self._wanted)) if n not in selected]
        if not missed:
            return run
        own = Piece(row.first_ns, (0,), lambda: run)
        pieces = heapq.merge([own], self.pieces(missed, (1,)), key=lambda piece: piece.first_ns)
        return Run([], 0, merge(pieces, self._file.noticed.note_late))

    def load_ahead(self, numbers: Iterable[int]) -> Iterator[Loaded]:
        parallel: int = getattr(self._file.source, "parallel_reads", 1)
        jobs = self._jobs(numbers, together=parallel > 1)
        most_bytes = MAX_AHEAD if parallel > 1 else _AHEAD_ON_DISK
        for group in do_ahead(jobs, workers=max(_LEAST_WORKERS, parallel), most_bytes=most_bytes):
            yield from group

    def _jobs(self, numbers: Iterable[int], *, together: bool) -> Iterator[Job[list[Loaded]]]:
        """Yield what is to be fetched; over a network, chunks that stand behind each other are fetched together."""
        group: list[Row] = []
        size, previous, alone = 0, -1, True
        for number in numbers:
            row = self._file.table.rows[number]
            joins = together and not alone and number == previous + 1 and row.start - group[0].start < _GROUP_BYTES
            if group and not joins:
                yield self._job(group, size)
                alone = False
                group, size = [], 0
            group.append(row)
            size += min(row.length + row.uncompressed_bytes, MAX_CHUNK_HELD)
            previous = number
        if group:
            yield self._job(group, size)

    def _job(self, group: list[Row], size: int) -> Job[list[Loaded]]:
        return Job(size, lambda: self._load_group(group))

    def _load_group(self, group: list[Row]) -> list[Loaded]:
        first = group[0]
        span = max(row.start + row.length for row in group) - first.start
        if len(group) == 1 or span > MAX_READ:
            return [self._load(row) for row in group]
        data = memoryview(self._file.source.read(first.start, span))
        return [self._take(row, data[row.start - first.start :][: row.length]) for row in group]

    def _load(self, row: Row) -> Loaded:
        if row.kind == RECORDS:
            if row.length > MAX_MESSAGE:
                return Malformed(
                    f"byte {row.start}", f"a message of {row.length} bytes; at most {MAX_MESSAGE} are read"
                )
        elif max(row.length, row.uncompressed_bytes) > MAX_CHUNK_HELD:
            return None
        return self._take(row, _read(self._file.source, row.start, row.length))

    def _take(self, row: Row, data: Buffer) -> Loaded:
        """Return the content of a row whose bytes are at hand: records as they stand, a chunk unpacked."""
        return data if row.kind == RECORDS else self._unpack(row, data)

    def _unpack(self, row: Row, data: Buffer) -> Loaded:
        try:
            stream = open_bytes(bytes(data[:_HEAD_BYTES]), row.start)
            head = self._file.format.open_chunk(stream)
            if head.uncompressed_bytes > MAX_CHUNK_HELD:
                return None
            start = stream.position - row.start
            stored = memoryview(data)[start : start + head.stored_bytes]
            if row.kind == CUT:
                return decompress_beginning(head.compression, bytes(stored), head.uncompressed_bytes)
            content = decompress(head.compression, stored, head.uncompressed_bytes)
            if head.crc and zlib.crc32(content) != head.crc:
                return Malformed(f"byte {row.start}", "its checksum is wrong")
        except Malformed as error:
            return error
        return content

    def open(self, row: Row, loaded: Loaded) -> Run:
        if loaded is None:
            return Run([], 0, self._large(row))
        if isinstance(loaded, Malformed):
            return self._salvaged(row, loaded)
        try:
            messages = self._parse(row, loaded)
        except Malformed as error:
            return self._salvaged(row, error)
        return Run(messages, len(loaded) + OVERHEAD_BYTES * len(messages))

    def read_again(self, row: Row) -> Block:
        loaded = self._load(row)
        if loaded is None or isinstance(loaded, Malformed):
            return []
        try:
            return self._parse(row, loaded)
        except Malformed:
            return []  # it was whole when it was read before: the file changes meanwhile

    def _salvaged(self, row: Row, damage: Malformed) -> Run:
        """Read what a scan finds in a damaged chunk, or instead of one that does not stand where the index says."""
        file = self._file
        gaps: Iterable[Gap] = []
        if not file.is_part and row.kind != RECORDS:
            is_there = row.kind == CUT or end_of_chunk(file.source, row, file.format.open_chunk) is not None
            gaps = [Gap(row.start, row.end)] if is_there else self._unlisted()
        size = sum(gap.end - gap.start for gap in gaps)
        saved = file.format.salvage(file.source, gaps, file.channels) if 0 < size <= self._salvage_left else None
        if saved is None or not saved.table.rows:
            self._note(row, damage)
            return Run([], 0)
        self._salvage_left -= size
        self._note_part(row, damage)
        inside = ChunkedFile(saved.part, file.format, saved.table, file.channels, file.noticed, is_part=True)
        return Run([], 0, self._compared(row, merge(pieces_of(inside, self._selection, ()))))

    def _unlisted(self) -> Iterable[Gap]:
        """Return where chunks may stand that the index lists somewhere else; at the second time nothing."""
        if self._searched:
            return []
        self._searched = True
        file = self._file
        message = "its index lists chunks where none stands: what stands between the others is read instead"
        file.noticed.add("index-damaged", file.source.name, message)
        return unlisted(file.source, file.table.rows, file.format.open_chunk)

    def _compared(self, row: Row, blocks: Iterator[Block]) -> Iterator[Block]:
        for block in blocks:
            self._compare_start(row, block)
            yield block

    def _parse(self, row: Row, content: Buffer) -> Block:
        """Return the wanted messages by time.

        Raises:
            Malformed: a record is damaged.
        """
        parse, messages = self._file.format.parse_messages, Block()
        stretches = self._file.table.stretches.get(row.start, ((0, len(content)),))
        for start, end in stretches:
            messages += parse(content[start:end], self._wanted, self._selection)
        messages.sort(key=_log_time)
        self._compare_start(row, messages)
        return messages

    def _large(self, row: Row) -> Iterator[Block]:
        """Read a chunk by way of a temporary file."""
        file = self._file
        faults: list[Malformed] = []
        try:
            with temporary_copy(self._content_of(row, faults)) as path, FileSource(path) as content:
                if faults:
                    self._note_part(row, faults[0])
                table = file.format.table_of_records(open_range(content, 0, content.size_bytes))
                inside = ChunkedFile(content, file.format, table, file.channels, file.noticed, is_part=True)
                yield from self._compared(row, merge(pieces_of(inside, self._selection, ())))
        except TooLarge as error:
            raise SourceError(f"{file.source.name}: the chunk at byte {row.start}: {error}") from error

    def _content_of(self, row: Row, faults: list[Malformed]) -> Callable[[int], bytes]:
        """Return a function that reads on in the content of a chunk; damage ends it, and is added to `faults`."""
        content: ForwardStream | None = None
        crc = claimed = 0

        def start() -> ForwardStream:
            nonlocal crc, claimed
            stream = open_range(self._file.source, row.start, row.start + row.length)
            head = self._file.format.open_chunk(stream)
            crc, claimed = head.crc, head.uncompressed_bytes
            opened = open_decompressed(head.compression, limited(stream, head.stored_bytes), head.uncompressed_bytes)
            opened.start_crc()
            return opened

        def read(most: int) -> bytes:
            nonlocal content
            try:
                content = content or start()
                piece = content.take_some(min(most, WINDOW))
            except Malformed as error:
                faults.append(error)
                return b""
            if not piece and crc and content.crc != crc:
                faults.append(Malformed(f"byte {row.start}", "its checksum is wrong"))
            if not piece and content.position < claimed and row.kind != CUT:
                came_out = f"{claimed} bytes are claimed, {content.position} came out"
                faults.append(Malformed(f"byte {row.start}", came_out))
            return piece

        return read

    def _compare_start(self, row: Row, messages: Block) -> None:
        """Note a chunk that holds other messages than the index says: it may have been opened too late for them."""
        if not messages:
            return
        if messages[-1].log_time_ns > row.last_ns:
            message = "it holds later messages than the index says"
            self._file.noticed.add("index-damaged", f"chunk at byte {row.start}", message)
            self._doubt_index()
        if messages[0].log_time_ns < row.first_ns:
            self._doubt_index()
            message = (
                "it holds earlier messages than the index says; those that came too late to be in order are left out"
            )
            self._file.noticed.add("index-damaged", f"chunk at byte {row.start}", message)

    def _doubt_index(self) -> None:
        if self._file.check is not None:
            self._file.check.doubt()

    def _note_part(self, row: Row, error: Malformed) -> None:
        message = f"only what could be saved of it is read: {error.message}"
        self._file.noticed.add("damaged", f"chunk at byte {row.start}", message)

    def _note(self, row: Row, error: Malformed) -> None:
        what = "messages" if row.kind == RECORDS else "chunk"
        self._file.noticed.add("damaged", f"{what} at byte {row.start}", f"left out: {error.message}")


def _read(source: Source, offset: int, length: int) -> bytes:
    if length <= MAX_READ:
        return source.read(offset, length)
    return b"".join(
        source.read(at, min(MAX_READ, offset + length - at)) for at in range(offset, offset + length, MAX_READ)
    )
