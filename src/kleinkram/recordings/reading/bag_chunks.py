"""Inside a ROS 1 bag: the head of a chunk, the messages of a chunk's content, and records one after the other."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from kleinkram.recordings.bag import records
from kleinkram.recordings.bag.records import Fields
from kleinkram.recordings.decompress import Buffer
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.index_claims import FoundMessages
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_HEADER
from kleinkram.recordings.reading.chunk_table import ChunkHead, ChunkTable, Row
from kleinkram.recordings.reading.mcap_chunks import RunBuilder
from kleinkram.recordings.reading.merging import Block
from kleinkram.recordings.reading.model import Channel, RawMessage, Schema, Selection
from kleinkram.recordings.sources import Source
from kleinkram.recordings.stream import ForwardStream, open_range

MESSAGE_DATA = 0x02
_HEAD_WINDOW = 4096
_U32 = struct.Struct("<I")
_S = 1_000_000_000


class Record(NamedTuple):
    """A record of a bag, up to its data."""

    start: int
    opcode: int
    fields: Fields
    data_bytes: int


class MessageHead(NamedTuple):
    """Where number and time stand in the header of a message record, and what stands around them."""

    layout: struct.Struct
    texts: tuple[bytes, bytes, bytes]
    time_first: bool


def open_chunk(stream: ForwardStream) -> ChunkHead:
    """Read a chunk record up to its stored bytes.

    Raises:
        Malformed: it is none.
    """
    head = records.read_chunk_head(stream)
    compression = "" if head.compression == "none" else head.compression
    return ChunkHead(compression, head.uncompressed_bytes, 0, head.data_bytes)


def read_message_index(source: Source, row: Row) -> FoundMessages | None:
    """Return what the index data behind a chunk list; None where there are none, or they cannot be read.

    Raises:
        SourceError: as `Source.read`.
    """
    stream, found = open_range(source, row.start, row.end, window=_HEAD_WINDOW), FoundMessages()
    try:
        stream.skip(records.read_chunk_head(stream).data_bytes)
        if not 0 < row.end - stream.position <= MAX_CHUNK_INDEX:
            return None
        stream = open_range(source, stream.position, row.end)
        while not stream.at_end():
            number, stamps, _offsets = records.read_index_data(stream)
            found.add_index(number, stamps)
    except Malformed:
        return None
    return found


def parse_messages(content: Buffer, wanted: Mapping[int, Channel], selection: Selection) -> Block:
    """Return the wanted messages of records, in the order in which they stand.

    Raises:
        Malformed: a record is damaged, or reaches beyond the content.
    """
    _, start_ns, end_ns = selection
    view = content if isinstance(content, bytes) else bytes(content)
    at, size, new = 0, len(view), tuple.__new__
    heads: dict[int, MessageHead] = {}
    found: Block = []
    while at + 8 <= size:
        (length,) = _U32.unpack_from(view, at)
        data_at = at + 8 + length
        if length > MAX_HEADER or data_at > size:
            raise Malformed(f"byte {at} of the chunk", "a record that reaches beyond the chunk")
        (data_bytes,) = _U32.unpack_from(view, data_at - 4)
        end = data_at + data_bytes
        if end > size:
            raise Malformed(f"byte {at} of the chunk", "a record that reaches beyond the chunk")
        number, log_ns = _read_message_head(view, at + 4, length, heads)
        channel = wanted.get(number)
        if channel is not None and start_ns <= log_ns < end_ns:
            found.append(new(RawMessage, (channel.topic, log_ns, log_ns, 0, view[data_at:end], channel)))
        at = end
    if at != size:
        raise Malformed(f"byte {at} of the chunk", "a record that ends before its fields")
    return found


def _read_message_head(view: bytes, at: int, length: int, heads: dict[int, MessageHead]) -> tuple[int, int]:
    """Return connection and time of a message; (-1, 0) of another record.

    Headers of one length are nearly always laid out alike: the layout of the last one is tried first.
    """
    known = heads.get(length)
    if known is not None:
        if known.time_first:
            before, seconds, nanoseconds, between, number, behind = known.layout.unpack_from(view, at)
        else:
            before, number, between, seconds, nanoseconds, behind = known.layout.unpack_from(view, at)
        if (before, between, behind) == known.texts:
            return number, seconds * _S + nanoseconds
    where = f"byte {at} of the chunk"
    raw = view[at : at + length]
    fields = Fields(raw, where)
    if fields.opcode() != MESSAGE_DATA:
        return -1, 0
    number, log_ns = fields.u32("conn"), fields.time_ns("time")
    heads[length] = _learn(raw)
    return number, log_ns


def _learn(raw: bytes) -> MessageHead:
    """Return how a header that holds number and time is laid out."""
    places = {name: (value_at, size) for name, value_at, size in _places(raw)}
    (conn_at, conn_size), (time_at, time_size) = places[b"conn"], places[b"time"]
    time_first = time_at < conn_at
    first, first_size, second, second_size = (
        (time_at, time_size, conn_at, conn_size) if time_first else (conn_at, conn_size, time_at, time_size)
    )
    texts = raw[:first], raw[first + first_size : second], raw[second + second_size :]
    numbers = ("II", "I") if time_first else ("I", "II")
    layout = f"<{len(texts[0])}s{numbers[0]}{len(texts[1])}s{numbers[1]}{len(texts[2])}s"
    return MessageHead(struct.Struct(layout), texts, time_first)


def _places(raw: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yield name, place and size of each field of a sound header."""
    at = 0
    while at < len(raw):
        (length,) = _U32.unpack_from(raw, at)
        name = raw[at + 4 : at + 4 + length].partition(b"=")[0]
        value_at = at + 4 + len(name) + 1
        yield name, value_at, at + 4 + length - value_at
        at += 4 + length


def walk(stream: ForwardStream) -> Iterator[Record]:
    """Yield the records of a stream; what the caller did not take of one's data is skipped.

    Raises:
        Malformed: no record begins where one should, or the last one is cut.
    """
    while not stream.at_end():
        start = stream.position
        fields, data_bytes = records.read_fields(stream)
        end = stream.position + data_bytes
        yield Record(start, fields.opcode(), fields, data_bytes)
        if stream.position < end:
            stream.skip(end - stream.position)


def table_of_records(stream: ForwardStream) -> ChunkTable:
    """Return where the messages of a stream stand, up to where it is damaged."""
    table = ChunkTable()
    builder = RunBuilder(table)
    try:
        for record in walk(stream):
            if record.opcode == MESSAGE_DATA:
                number, log_ns = record.fields.u32("conn"), record.fields.time_ns("time")
                stream.skip(record.data_bytes)
                builder.add(record.start, stream.position, number, log_ns)
    except Malformed:
        pass  # whoever wrote the stream has said what is wrong with it
    builder.close()
    return table


_MD5_OF_NOTHING = "d41d8cd98f00b204e9800998ecf8427e"
"""The md5sum of a type without fields: its empty definition is no missing one."""


def read_connection(fields: Fields, data: bytes, where: str) -> tuple[int, Channel]:
    """Return number and channel of a connection record."""
    inner = Fields(data, where)
    topic = fields.text("topic") or inner.text("topic", "")
    name = inner.text("type")
    definition = inner.blob("message_definition")
    if not definition.strip() and inner.text("md5sum", "") == _MD5_OF_NOTHING:
        definition = b"# no fields\n"
    schema = Schema(name, "ros1msg", definition)
    return fields.u32("conn"), Channel(topic, "ros1", schema)
