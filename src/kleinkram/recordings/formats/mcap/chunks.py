"""Messages in MCAP chunks: the fast loops of scans, and parsing of selected messages."""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterable, Iterator, Mapping
from itertools import repeat
from operator import eq
from typing import NamedTuple

from kleinkram.recordings.chunk_table import ChunkTable, Row, StoredChunk
from kleinkram.recordings.compression import Buffer, decompress, decompress_beginning
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import RECORD_HEAD, McapFacts, Opcode
from kleinkram.recordings.formats.mcap.resync import CHUNK_FIXED, no_record
from kleinkram.recordings.index_check import ChunkMessages
from kleinkram.recordings.limits import MAX_CHUNK_BYTES, MAX_CHUNK_INDEX, MAX_NAME, MAX_TAKE, WINDOW
from kleinkram.recordings.message_counts import Batch, MessagePlace, PlaceKind
from kleinkram.recordings.messages import Block, Channel, RawMessage, Selection
from kleinkram.recordings.sources import Source
from kleinkram.recordings.streams import ByteStream, LookaheadStream, open_range

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_OPCODE = int(Opcode.MESSAGE)  # faster to compare with than a member of an enum
MESSAGE_FIXED = MESSAGE_HEAD.size - RECORD_HEAD.size


_INDEXED_HEAD = struct.Struct("<B8xH4xQ")


def points_at_messages(content: bytes, channel_id: int, stamps: Iterable[int], offsets: array[int]) -> bool:
    """Return whether the messages of a channel with these log times are at these offsets of a chunk."""
    if offsets and max(offsets) > len(content) - MESSAGE_HEAD.size:
        return False
    heads = map(_INDEXED_HEAD.unpack_from, repeat(content), offsets)
    return all(map(eq, heads, zip(repeat(_MESSAGE_OPCODE), repeat(channel_id), stamps)))  # repeat never ends


def walk_messages(data: Buffer, at: int, end: int, batch: Batch) -> tuple[int, int]:
    """Add messages from `at` on to the batch, up to another record or one that ends after `end`.

    Returns:
        Where that is, and where the last message begins; twice the same without any message.
    """
    unpack, size, fixed = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size, MESSAGE_FIXED
    last_head, start = end - size, at
    while at <= last_head:
        opcode, length, channel_id, _sequence, log_time, publish_time = unpack(data, at)
        after = at + 9 + length
        if opcode != _MESSAGE_OPCODE or after > end or length < fixed:
            break
        batch[channel_id].extend((log_time, publish_time, after - at))
        start, at = at, after
    return at, start


_U64 = struct.Struct("<Q")
_DEFINITIONS = {Opcode.SCHEMA: records.read_schema, Opcode.CHANNEL: records.read_channel}


class ChunkHead(NamedTuple):
    """The fixed fields of a chunk record; `data_start` counts from the start of the record."""

    compression: str
    uncompressed: int
    crc: int
    data_start: int
    stored: int
    first_ns: int
    last_ns: int
    is_unfinished: bool = False


class McapChunkContents(NamedTuple):
    """The result of reading the records of a chunk.

    Attributes:
        walked: bytes of records that could be followed.
        fault: why it ended there; None: at the end.
        raw: the content of a whole chunk.
    """

    walked: int
    fault: Malformed | None = None
    raw: bytes = b""


def read_chunk_head(data: Buffer, at: int) -> ChunkHead:
    """Read the head of a chunk record whose lengths agree, or that was never finished."""
    (length,) = _U64.unpack_from(data, at + 1)
    at += RECORD_HEAD.size
    first_ns, last_ns, uncompressed, crc, name_length = CHUNK_FIXED.unpack_from(data, at)
    name_at = at + CHUNK_FIXED.size
    data_at = name_at + name_length + _U64.size
    name = bytes(data[name_at : name_at + name_length]).decode("utf-8", "replace")
    (stored,) = _U64.unpack_from(data, data_at - _U64.size)
    data_start = data_at - at + RECORD_HEAD.size
    if records.PLACEHOLDER not in (length, uncompressed, stored):
        return ChunkHead(name, uncompressed, crc, data_start, stored, first_ns, last_ns)
    if uncompressed == records.PLACEHOLDER:
        uncompressed, crc = MAX_CHUNK_BYTES, 0
    return ChunkHead(name, uncompressed, crc, data_start, stored, first_ns, last_ns, is_unfinished=True)


def read_chunk(stored: Buffer, head: ChunkHead, facts: McapFacts, batch: Batch) -> McapChunkContents:
    """Add the messages of a whole chunk to the batch.

    Raises:
        Malformed: nothing in it can be believed.
    """
    raw = decompress(head.compression, stored, head.uncompressed)
    if head.crc and zlib.crc32(raw) != head.crc:
        raise Malformed("chunk", "its checksum is wrong")
    return walk_contents(raw, facts, batch)._replace(raw=raw)


def read_beginning(stored: bytes, head: ChunkHead, facts: McapFacts, batch: Batch) -> McapChunkContents:
    """Add the messages of a chunk whose end is missing."""
    raw = decompress_beginning(head.compression, stored, min(head.uncompressed, MAX_CHUNK_BYTES))
    return walk_contents(raw, facts, batch)._replace(raw=raw)


def notify(facts: McapFacts, place: MessagePlace, batch: Batch) -> None:
    """Pass messages at a place to the observer, if there is one."""
    if facts.observer is not None:
        facts.observer.on_messages(place, batch)


def walk_contents(raw: bytes, facts: McapFacts, batch: Batch) -> McapChunkContents:
    """Add the messages of records to the batch, up to the first damage."""
    at, end = 0, len(raw)
    while True:
        at, _ = walk_messages(raw, at, end, batch)
        if at == end:
            return McapChunkContents(at)
        if end - at < RECORD_HEAD.size:
            return McapChunkContents(at, Malformed(f"byte {at}", "it ends within a record"))
        opcode, length = RECORD_HEAD.unpack_from(raw, at)
        body = at + RECORD_HEAD.size
        if opcode in (0, Opcode.MESSAGE) or body + length > end:
            return McapChunkContents(at, Malformed(f"byte {at}", "its records break off"))
        if opcode in _DEFINITIONS:
            try:
                _DEFINITIONS[opcode](facts, raw[body : body + min(length, MAX_TAKE)], f"byte {at}")
            except Malformed as fault:
                return McapChunkContents(at, fault)
        at = body + length


def read_large_message(stream: LookaheadStream) -> tuple[int, tuple[int, int, int]]:
    """Return channel and row of the next message, of which only the head is in the window.

    Raises:
        Malformed: it is too short to be one.
    """
    head = stream.window[stream.at : stream.at + MESSAGE_HEAD.size]
    if len(head) < MESSAGE_HEAD.size or MESSAGE_HEAD.unpack(head)[1] < MESSAGE_FIXED:
        raise Malformed(f"byte {stream.position}", "a message that is too short to be one")
    _opcode, length, channel_id, _sequence, log_time, publish_time = MESSAGE_HEAD.unpack(head)
    return channel_id, (log_time, publish_time, RECORD_HEAD.size + length)


MESSAGE_FIELDS = struct.Struct("<HIQQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK_FIXED = struct.Struct("<QQQII")
_MOST_OF_RUN = 8192


class McapRecord(NamedTuple):
    """A record. `head`: of a message, the fields before its data; of a definition, the body; else empty."""

    opcode: int
    start: int
    length: int
    head: bytes


def open_chunk(stream: ByteStream) -> StoredChunk:
    """Read a chunk record up to its stored bytes.

    Raises:
        Malformed: it is none, or its fields contradict each other.
    """
    start = stream.position
    opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise Malformed(f"byte {start}", f"a record of type {opcode} where a chunk should be")
    return read_chunk_fields(stream, length)


def read_chunk_fields(stream: ByteStream, length: int) -> StoredChunk:
    """Read the fields of a chunk record of `length` bytes, up to its stored bytes.

    Raises:
        Malformed: they contradict each other.
    """
    where, end = f"byte {stream.position}", stream.position + length
    _first_ns, _last_ns, uncompressed, crc, name_length = _CHUNK_FIXED.unpack(stream.take(_CHUNK_FIXED.size))
    if name_length > MAX_NAME:
        raise Malformed(where, f"the name of its compression has {name_length} bytes")
    name = stream.take(name_length).decode("utf-8", "replace")
    (stored,) = _U64.unpack(stream.take(_U64.size))
    if records.PLACEHOLDER in (length, uncompressed, stored):
        if uncompressed == records.PLACEHOLDER:
            uncompressed, crc = MAX_CHUNK_BYTES, 0
        return StoredChunk(name, uncompressed, crc, stored)
    if stored != end - stream.position:
        raise Malformed(where, f"{stored} bytes are claimed, {end - stream.position} are there")
    return StoredChunk(name, uncompressed, crc, stored)


def read_message_index(source: Source, row: Row) -> ChunkMessages | None:
    """Return the messages that the indexes after a chunk list; None if there are none, or they cannot be read.

    Raises:
        SourceError: as `Source.read`.
    """
    index_start = row.start + row.length
    if not 0 < row.end - index_start <= MAX_CHUNK_INDEX:
        return None
    stream, messages = open_range(source, index_start, row.end), ChunkMessages()
    try:
        while not stream.at_end():
            where = f"byte {stream.position}"
            opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
            if opcode != Opcode.MESSAGE_INDEX:
                return None
            channel_id, stamps, _offsets = records.read_message_index(stream.take(length), where)
            messages.add_index(channel_id, stamps)
    except Malformed:
        return None
    return messages


def parse_messages(content: Buffer, channels: Mapping[int, Channel], selection: Selection) -> Block:
    """Return the selected messages of records, in file order.

    Raises:
        Malformed: a record reaches beyond the content.
    """
    _, start_ns, end_ns = selection
    view = content if isinstance(content, bytes) else bytes(content)
    unpack, message, channel_of, new = _MESSAGE.unpack_from, _MESSAGE_OPCODE, channels.get, tuple.__new__
    at, size = 0, len(view)
    last = size - _MESSAGE.size
    messages: Block = []
    while at <= last:
        opcode, length, channel_id, sequence, log_ns, publish_ns = unpack(view, at)
        end = at + 9 + length
        if opcode == message:
            if end > size or length < 22:
                raise Malformed(f"byte {at} of the chunk", "a message that reaches beyond the chunk")
            channel = channel_of(channel_id)
            if channel is not None and start_ns <= log_ns < end_ns:
                messages.append(
                    new(RawMessage, (channel.topic, log_ns, publish_ns, sequence, view[at + 31 : end], channel))
                )
        at = end
    if at != size and (at > size or not _is_short_tail(view, at)):
        raise Malformed(f"byte {at} of the chunk", "a record that reaches beyond the chunk")
    return messages


def _is_short_tail(view: bytes, at: int) -> bool:
    """Return whether the rest, shorter than a message, is whole records."""
    while at + records.RECORD_HEAD.size <= len(view):
        opcode, length = records.RECORD_HEAD.unpack_from(view, at)
        if opcode == Opcode.MESSAGE:
            return False
        at += records.RECORD_HEAD.size + length
    return at == len(view)


def read_records(stream: ByteStream) -> Iterator[McapRecord]:
    """Yield the records of a stream; unread bytes of one are skipped.

    Raises:
        Malformed: no record begins where one should, or the last one is cut.
    """
    while not stream.at_end():
        start = stream.position
        record_head = stream.take(records.RECORD_HEAD.size)
        opcode, length = records.RECORD_HEAD.unpack(record_head)
        end = stream.position + length
        if opcode == 0:
            raise Malformed(f"byte {start}", no_record(record_head))
        head = b""
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE_FIELDS.size:
                raise Malformed(f"byte {start}", f"a message of {length} bytes, too short to be one")
            head = stream.take(MESSAGE_FIELDS.size)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            head = stream.take(length)
        yield McapRecord(opcode, start, length, head)
        if stream.position < end:
            stream.skip(end - stream.position)


class RunBuilder:
    """Combines adjacent messages outside of chunks into rows of about 1 MB."""

    def __init__(self, table: ChunkTable) -> None:
        self._table = table
        self._start = self._end = 0
        self._first_ns, self._last_ns = 2**64 - 1, 0
        self._channels: set[int] = set()
        self._count = 0

    def add(self, start: int, end: int, channel_id: int, log_ns: int) -> None:
        """Add a message that is at [start, end)."""
        if not self._count:
            self._start = start
        elif end - self._start > WINDOW or self._count >= _MOST_OF_RUN:
            self.close()
            self._start = start
        self._end = end
        self._first_ns, self._last_ns = min(self._first_ns, log_ns), max(self._last_ns, log_ns)
        self._channels.add(channel_id)
        self._count += 1

    def close(self) -> None:
        """End the current row, if there is one."""
        if self._count:
            length = self._end - self._start
            members = self._table.sets.number(self._channels)
            row = Row(self._start, length, self._end, self._first_ns, self._last_ns, PlaceKind.records, members, length)
            self._table.rows.append(row)
        self._first_ns, self._last_ns, self._count = 2**64 - 1, 0, 0
        self._channels = set()


def table_of_records(stream: ByteStream) -> ChunkTable:
    """Return the places of the messages in a stream, up to the first damage."""
    table = ChunkTable()
    builder = RunBuilder(table)
    try:
        for record in read_records(stream):
            if record.opcode == Opcode.MESSAGE:
                channel_id, _, log_ns, _ = MESSAGE_FIELDS.unpack(record.head)
                end = record.start + records.RECORD_HEAD.size + record.length
                stream.skip(end - stream.position)
                builder.add(record.start, end, channel_id, log_ns)
    except Malformed:
        pass  # already reported by the writer of the stream
    builder.close()
    return table
