"""Inside an MCAP: the head of a chunk, the messages of a chunk's content, and records one after the other."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from kleinkram.recordings.decompress import Buffer
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.index_claims import FoundMessages
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_NAME, WINDOW
from kleinkram.recordings.listening import RECORDS
from kleinkram.recordings.mcap import records
from kleinkram.recordings.mcap.plausible import no_record
from kleinkram.recordings.reading.chunk_table import ChunkHead, ChunkTable, Row
from kleinkram.recordings.reading.merging import Block
from kleinkram.recordings.reading.model import Channel, RawMessage, Selection
from kleinkram.recordings.sources import Source
from kleinkram.recordings.stream import ForwardStream, open_range

MESSAGE_HEAD = struct.Struct("<HIQQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK_FIXED = struct.Struct("<QQQII")
_U64 = struct.Struct("<Q")
_MOST_OF_RUN = 8192


class Record(NamedTuple):
    """A record; of a message `head` are the fields before its data, of a definition the whole body, else nothing."""

    opcode: int
    start: int
    length: int
    head: bytes


def open_chunk(stream: ForwardStream) -> ChunkHead:
    """Read a chunk record up to its stored bytes.

    Raises:
        Malformed: it is none, or its fields contradict each other.
    """
    start = stream.position
    opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
    if opcode != records.CHUNK:
        raise Malformed(f"byte {start}", f"a record of type {opcode} where a chunk should be")
    return read_chunk_head(stream, length)


def read_chunk_head(stream: ForwardStream, length: int) -> ChunkHead:
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
            uncompressed, crc = records.UNFINISHED_CHUNK_BYTES, 0
        return ChunkHead(name, uncompressed, crc, stored)
    if stored != end - stream.position:
        raise Malformed(where, f"{stored} bytes are claimed, {end - stream.position} are there")
    return ChunkHead(name, uncompressed, crc, stored)


def read_message_index(source: Source, row: Row) -> FoundMessages | None:
    """Return what the message indexes behind a chunk list; None where there are none, or they cannot be read.

    Raises:
        SourceError: as `Source.read`.
    """
    index_start = row.start + row.length
    if not 0 < row.end - index_start <= MAX_CHUNK_INDEX:
        return None
    stream, found = open_range(source, index_start, row.end), FoundMessages()
    try:
        while not stream.at_end():
            where = f"byte {stream.position}"
            opcode, length = records.RECORD_HEAD.unpack(stream.take(records.RECORD_HEAD.size))
            if opcode != records.MESSAGE_INDEX:
                return None
            channel_id, stamps, _offsets = records.read_message_index(stream.take(length), where)
            found.add_index(channel_id, stamps)
    except Malformed:
        return None
    return found


def parse_messages(content: Buffer, wanted: Mapping[int, Channel], selection: Selection) -> Block:
    """Return the wanted messages of records, in the order in which they stand.

    Raises:
        Malformed: a record reaches beyond the content.
    """
    _, start_ns, end_ns = selection
    view = content if isinstance(content, bytes) else bytes(content)
    unpack, message, channel_of, new = _MESSAGE.unpack_from, records.MESSAGE, wanted.get, tuple.__new__
    at, size = 0, len(view)
    last = size - _MESSAGE.size
    found: Block = []
    while at <= last:
        opcode, length, channel_id, sequence, log_ns, publish_ns = unpack(view, at)
        end = at + 9 + length
        if opcode == message:
            if end > size or length < 22:
                raise Malformed(f"byte {at} of the chunk", "a message that reaches beyond the chunk")
            channel = channel_of(channel_id)
            if channel is not None and start_ns <= log_ns < end_ns:
                found.append(
                    new(RawMessage, (channel.topic, log_ns, publish_ns, sequence, view[at + 31 : end], channel))
                )
        at = end
    if at != size and (at > size or not _is_short_tail(view, at)):
        raise Malformed(f"byte {at} of the chunk", "a record that reaches beyond the chunk")
    return found


def _is_short_tail(view: bytes, at: int) -> bool:
    """Say whether what is left, less than a message needs, is whole records."""
    while at + records.RECORD_HEAD.size <= len(view):
        opcode, length = records.RECORD_HEAD.unpack_from(view, at)
        if opcode == records.MESSAGE:
            return False
        at += records.RECORD_HEAD.size + length
    return at == len(view)


def walk(stream: ForwardStream) -> Iterator[Record]:
    """Yield the records of a stream; what the caller did not take of one is skipped.

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
        if opcode == records.MESSAGE:
            if length < MESSAGE_HEAD.size:
                raise Malformed(f"byte {start}", f"a message of {length} bytes, too short to be one")
            head = stream.take(MESSAGE_HEAD.size)
        elif opcode in (records.SCHEMA, records.CHANNEL):
            head = stream.take(length)
        yield Record(opcode, start, length, head)
        if stream.position < end:
            stream.skip(end - stream.position)


class RunBuilder:
    """Gathers messages that follow each other without a chunk into rows of about 1 MB."""

    def __init__(self, table: ChunkTable) -> None:
        self._table = table
        self._start = self._end = 0
        self._first_ns, self._last_ns = 2**64 - 1, 0
        self._channels: set[int] = set()
        self._count = 0

    def add(self, start: int, end: int, channel_id: int, log_ns: int) -> None:
        """Add a message that stands at [start, end)."""
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
        """End the row that was begun, if any: something else follows."""
        if self._count:
            length = self._end - self._start
            members = self._table.sets.number(self._channels)
            row = Row(self._start, length, self._end, self._first_ns, self._last_ns, RECORDS, members, length)
            self._table.rows.append(row)
        self._first_ns, self._last_ns, self._count = 2**64 - 1, 0, 0
        self._channels = set()


def table_of_records(stream: ForwardStream) -> ChunkTable:
    """Return where the messages of a stream stand, up to where it is damaged."""
    table = ChunkTable()
    builder = RunBuilder(table)
    try:
        for record in walk(stream):
            if record.opcode == records.MESSAGE:
                channel_id, _, log_ns, _ = MESSAGE_HEAD.unpack(record.head)
                end = record.start + records.RECORD_HEAD.size + record.length
                stream.skip(end - stream.position)
                builder.add(record.start, end, channel_id, log_ns)
    except Malformed:
        pass  # whoever wrote the stream has said what is wrong with it
    builder.close()
    return table
