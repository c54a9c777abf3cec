"""Records in bag chunks: the fast loops of scans, and parsing of selected messages.

The header of a message has always the same fields and the same length, only their order is the writer's. So the
layout is taken from the first message, and every other header is compared with it as a whole.
"""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from operator import itemgetter
from typing import NamedTuple

from kleinkram.recordings.chunk_table import Row, StoredChunk
from kleinkram.recordings.compression import Buffer
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.rosbag1 import records
from kleinkram.recordings.formats.rosbag1.records import Connection, Fields, Op
from kleinkram.recordings.index_check import ChunkMessages
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_DEFINITIONS, MAX_HEADER, MAX_NAMES, MAX_TAKE, MAX_TOPICS
from kleinkram.recordings.message_counts import Batch, MessageObserver, ReadableRanges
from kleinkram.recordings.messages import Block, Channel, RawMessage, Schema, Selection
from kleinkram.recordings.sources import Source
from kleinkram.recordings.streams import ByteStream, open_range

_FIELDS = {b"op": "8s", b"conn": "9sI", b"time": "9sII"}
_VALUES = {b"op": 1, b"conn": 2, b"time": 3}
_HEADER_BYTES = 38
_U32 = struct.Struct("<I")


class MessageLayout:
    """The order of the fields in message headers, learned from one of them."""

    def __init__(self, order: tuple[bytes, ...], data: Buffer, at: int) -> None:
        self.layout = struct.Struct("<I" + "".join(_FIELDS[name] for name in order) + "I")
        constants, place = [0], 1
        for name in order:
            constants.append(place)
            if name == b"conn":
                connection = place + 1
            elif name == b"time":
                time = place + 1
            place += _VALUES[name]
        self.constants: Callable[[tuple[object, ...]], object] = itemgetter(*constants)
        self.expected = self.constants(self.layout.unpack_from(data, at))
        self.values: Callable[[tuple[int, ...]], tuple[int, int, int, int]] = itemgetter(
            connection, time, time + 1, place
        )


def learn_layout(data: Buffer, at: int) -> MessageLayout | None:
    """Return the layout of the message record at `at`; None if it is unusual."""
    if _U32.unpack_from(data, at)[0] != _HEADER_BYTES:
        return None
    order, place, end = [], at + _U32.size, at + _U32.size + _HEADER_BYTES
    while place < end:
        length = int(_U32.unpack_from(data, place)[0])
        order.append(bytes(data[place + _U32.size : place + _U32.size + length]).partition(b"=")[0])
        place += _U32.size + length
    return MessageLayout(tuple(order), data, at) if sorted(order) == sorted(_FIELDS) else None


def walk_messages(data: Buffer, at: int, end: int, layout: MessageLayout, batch: Batch) -> tuple[int, int]:
    """Add messages from `at` on to the batch, up to another record or one that ends after `end`.

    Returns:
        Where that is, and where the last message begins; twice the same without any message.
    """
    unpack, size = layout.layout.unpack_from, layout.layout.size
    constants, expected, values = layout.constants, layout.expected, layout.values
    last_head, start = end - size, at
    while at <= last_head:
        header = unpack(data, at)
        if constants(header) != expected:
            break
        connection, seconds, nanoseconds, length = values(header)
        after = at + size + length
        if after > end:
            break
        batch[connection].extend((seconds * 1_000_000_000 + nanoseconds, 0, after - at))
        start, at = at, after
    return at, start


_OP = re.compile(rb"\x04\0\0\0op=[\x02-\x07]")
_OP_OUTSIDE = re.compile(rb"\x04\0\0\0op=[\x03-\x06]")
_LONGEST_SEARCHED_HEADER = 512
_MOST_CHECKED = 2


@dataclass
class BagFacts:
    """What the records of a bag define. `observer`: receives the places of messages."""

    connections: dict[int, Connection] = field(default_factory=dict)
    names_bytes: int = 0
    definition_bytes: int = 0
    layout: MessageLayout | None = None
    observer: MessageObserver | None = None

    def define(self, number: int, connection: Connection, where: str) -> None:
        """Note a connection; the first of a number counts."""
        if number in self.connections:
            return
        self.names_bytes += len(connection.topic) + len(connection.message_type) + len(connection.publisher)
        if len(self.connections) >= MAX_TOPICS or self.names_bytes > MAX_NAMES:
            raise Malformed(where, "more connections than are read", certain=False)
        self.definition_bytes += len(connection.definition)
        fits = self.definition_bytes <= MAX_DEFINITIONS
        self.connections[number] = connection if fits else connection._replace(definition=b"")

    def channels(self) -> dict[int, Channel]:
        """Return the connections as channels."""
        return {
            number: Channel(one.topic, "ros1", Schema(one.message_type, "ros1msg", one.definition))
            for number, one in self.connections.items()
        }


class Hole(NamedTuple):
    """Skipped bytes of a chunk: [start, end)."""

    start: int
    end: int
    fault: Malformed


class BagChunkContents(NamedTuple):
    """The result of reading the records of a chunk; `end`: of the chunk, in its bytes.

    `readable_ranges`: ranges of whole records. Behind a message whose length is wrong they overlap.
    """

    holes: list[Hole]
    end: int
    readable_ranges: ReadableRanges


@dataclass(frozen=True)
class BagRecord:
    """A record; `start`, `data_start` and `end` are offsets in the bytes that it was read from."""

    fields: Fields
    opcode: int
    start: int
    data_start: int
    end: int

    @property
    def data_bytes(self) -> int:
        """Length of the data."""
        return self.end - self.data_start


def parse_record(data: Buffer, at: int, where: str) -> BagRecord:
    """Read the header of a record.

    Raises:
        Malformed: there is none, or it is not wholly in memory.
    """
    if at + 2 * _U32.size > len(data):
        raise Malformed(where, "a record breaks off")
    header_bytes = int(_U32.unpack_from(data, at)[0])
    header_at = at + _U32.size
    if header_bytes > MAX_HEADER:
        raise Malformed(where, "no record where one should begin")
    if header_at + header_bytes + _U32.size > len(data):
        raise Malformed(where, "a record breaks off")
    fields = Fields(bytes(data[header_at : header_at + header_bytes]), where)
    opcode = fields.opcode()
    if not Op.MESSAGE_DATA <= opcode <= Op.CONNECTION:
        raise Malformed(where, f"a record of type {opcode}, which no bag has")
    data_start = header_at + header_bytes + _U32.size
    data_bytes = int(_U32.unpack_from(data, data_start - _U32.size)[0])
    record = BagRecord(fields, opcode, at, data_start, data_start + data_bytes)
    _check_lengths(record, where)
    return record


def _check_lengths(record: BagRecord, where: str) -> None:
    fields, data_bytes = record.fields, record.data_bytes
    if record.opcode == Op.MESSAGE_DATA:
        fields.u32("conn"), fields.time_ns("time")
    elif record.opcode == Op.CONNECTION:
        fields.u32("conn"), fields.text("topic")
    elif record.opcode == Op.CHUNK:
        if fields.text("compression") == "none" and fields.u32("size") != data_bytes:
            raise Malformed(where, "a chunk whose lengths contradict each other")
    elif record.opcode == Op.INDEX_DATA:
        if data_bytes != records.INDEX_ENTRY_BYTES * fields.u32("count"):
            raise Malformed(where, "index data whose length does not fit its count")
    elif record.opcode == Op.CHUNK_INFO and data_bytes != 8 * fields.u32("count"):
        raise Malformed(where, "a chunk info whose length does not fit its count")


def find_record(data: Buffer, start: int, end: int, *, outside: bool = False) -> int | None:
    """Return the first place in [start, end) where the header of a record begins, with its field `op` inside.

    `outside`: only records of the kinds that are outside of chunks.
    """
    untried = start
    for match in (_OP_OUTSIDE if outside else _OP).finditer(data, start, end):
        field_at = match.start()
        for at in range(field_at - _U32.size, max(untried, field_at - _LONGEST_SEARCHED_HEADER) - 1, -1):
            header_bytes = int(_U32.unpack_from(data, at)[0])
            if field_at + 8 - at - _U32.size <= header_bytes <= _LONGEST_SEARCHED_HEADER and is_record(data, at):
                return at
        # A place that is no record, or whose header ends before this field, is none for a later field either.
        untried = max(untried, field_at - _U32.size + 1)
    return None


def points_at_messages(content: Buffer, number: int, entries: array[int], layout: MessageLayout | None) -> bool:
    """Return whether messages of a connection are where index data say; checks the first, the last and a sample.

    `entries`: seconds, nanoseconds and place in the chunk of each message.

    Raises:
        Malformed: no record is at one of the places.
    """
    count = len(entries) // 3
    for at in {*range(0, count, max(1, count // _MOST_CHECKED)), max(0, count - 1)} if count else ():
        seconds, nanoseconds, place = entries[3 * at : 3 * at + 3]
        actual = _message_at(content, place, layout)
        if actual != (number, seconds, nanoseconds):
            return False
    return True


def _message_at(content: Buffer, place: int, layout: MessageLayout | None) -> tuple[int, int, int] | None:
    """Return connection, seconds and nanoseconds of a message; None for another record."""
    if layout is not None and place + layout.layout.size <= len(content):
        fields = layout.layout.unpack_from(content, place)
        if layout.constants(fields) == layout.expected:
            return layout.values(fields)[:3]
    record = parse_record(content, place, "")
    if record.opcode != Op.MESSAGE_DATA:
        return None
    seconds, nanoseconds = divmod(record.fields.time_ns("time"), 10**9)
    return record.fields.u32("conn"), seconds, nanoseconds


def is_record(data: Buffer, at: int) -> bool:
    """Return whether a record header begins here."""
    try:
        parse_record(data, at, "")
    except Malformed:
        return False
    return True


def stands_outside_chunks(data: Buffer, at: int) -> bool:
    """Return whether a record header begins here that is never inside a chunk."""
    try:
        return parse_record(data, at, "").opcode != Op.MESSAGE_DATA
    except Malformed:
        return False


def read_contents(raw: bytes, facts: BagFacts, batch: Batch, *, ends_early: bool = False) -> BagChunkContents:
    """Add the messages in `raw` to the batch.

    `ends_early`: `raw` may reach further than the chunk does, because bytes of it are missing: it ends where a record
    is that no chunk holds.
    """
    holes: list[Hole] = []
    readable_ranges: list[tuple[int, int]] = []
    at, end = 0, len(raw)
    first = at
    # Where the record before begins; behind a hole: none.
    previous = -1
    while at < end:
        before = at
        at, last = walk_known_layout(raw, at, end, facts, batch)
        if at == end:
            break
        previous = last if at > before else previous
        try:
            previous, at = at, read_record(raw, at, facts, batch)
        except Malformed as fault:
            readable_ranges.append((first, at))
            if ends_early and find_record(raw, at, at + _LONGEST_SEARCHED_HEADER, outside=True) == at:
                holes.append(Hole(at, at, Malformed(fault.where, "its end is missing")))
                return BagChunkContents(holes, at, tuple(readable_ranges))
            # The length of the record before may be what is wrong.
            record_at = find_record(raw, (at if previous < 0 else previous) + 1, end)
            after = end if record_at is None else record_at
            holes.append(Hole(at, max(at, after), fault))
            first = at = after
            previous = -1
    return BagChunkContents(holes, end, (*readable_ranges, (first, end)))


def walk_known_layout(data: Buffer, at: int, end: int, facts: BagFacts, batch: Batch) -> tuple[int, int]:
    """Add messages of the known layout; return where they end, and where the last one begins."""
    return walk_messages(data, at, end, facts.layout, batch) if facts.layout else (at, at)


def read_record(data: Buffer, at: int, facts: BagFacts, batch: Batch) -> int:
    """Read one whole connection or message; return where it ends.

    Raises:
        Malformed: it is neither, or not all there.
    """
    where = f"byte {at} of its contents"
    record = parse_record(data, at, where)
    if record.end > len(data):
        raise Malformed(where, "a record reaches beyond the end")
    if record.opcode == Op.CONNECTION:
        define(record, bytes(data[record.data_start : record.end]), facts, where)
    elif record.opcode == Op.MESSAGE_DATA:
        add_message(record, batch)
        if facts.layout is None:
            facts.layout = learn_layout(data, at)
    else:
        raise Malformed(where, f"a record of type {record.opcode} in a chunk")
    return record.end


def add_message(record: BagRecord, batch: Batch) -> None:
    """Add one message to the batch."""
    row = (record.fields.time_ns("time"), 0, record.end - record.start)
    batch[record.fields.u32("conn")].extend(row)


def define(record: BagRecord, data: bytes, facts: BagFacts, where: str) -> None:
    """Note a connection.

    Raises:
        Malformed: it is damaged, or larger than is read.
    """
    if record.data_bytes > MAX_TAKE:
        raise Malformed(where, f"a connection of {record.data_bytes} bytes", certain=False)
    number, connection = records.read_connection(record.fields, data, where)
    facts.define(number, connection, where)


_HEAD_WINDOW = 4096
_S = 1_000_000_000


class MessageHead(NamedTuple):
    """Where number and time are in a message header, and the bytes around them."""

    layout: struct.Struct
    texts: tuple[bytes, bytes, bytes]
    time_first: bool


def open_chunk(stream: ByteStream) -> StoredChunk:
    """Read a chunk record up to its stored bytes.

    Raises:
        Malformed: it is none.
    """
    head = records.read_chunk_head(stream)
    compression = "" if head.compression == "none" else head.compression
    return StoredChunk(compression, head.uncompressed_bytes, 0, head.data_bytes)


def read_message_index(source: Source, row: Row) -> ChunkMessages | None:
    """Return the messages that the index data after a chunk list; None if there are none, or they cannot be read.

    Raises:
        SourceError: as `Source.read`.
    """
    stream, messages = open_range(source, row.start, row.end, window=_HEAD_WINDOW), ChunkMessages()
    try:
        stream.skip(records.read_chunk_head(stream).data_bytes)
        if not 0 < row.end - stream.position <= MAX_CHUNK_INDEX:
            return None
        stream = open_range(source, stream.position, row.end)
        while not stream.at_end():
            number, stamps, _offsets = records.read_index_data(stream)
            messages.add_index(number, stamps)
    except Malformed:
        return None
    return messages


def parse_messages(content: Buffer, channels: Mapping[int, Channel], selection: Selection) -> Block:
    """Return the selected messages of records, in file order.

    Raises:
        Malformed: a record is damaged, or reaches beyond the content.
    """
    _, start_ns, end_ns = selection
    view = content if isinstance(content, bytes) else bytes(content)
    at, size, new = 0, len(view), tuple.__new__
    heads: dict[int, MessageHead] = {}
    messages: Block = []
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
        channel = channels.get(number)
        if channel is not None and start_ns <= log_ns < end_ns:
            messages.append(new(RawMessage, (channel.topic, log_ns, log_ns, 0, view[data_at:end], channel)))
        at = end
    if at != size:
        raise Malformed(f"byte {at} of the chunk", "a record that ends before its fields")
    return messages


def _read_message_head(view: bytes, at: int, length: int, heads: dict[int, MessageHead]) -> tuple[int, int]:
    """Return connection and time of a message; (-1, 0) for another record.

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
    if fields.opcode() != Op.MESSAGE_DATA:
        return -1, 0
    number, log_ns = fields.u32("conn"), fields.time_ns("time")
    heads[length] = _learn(raw)
    return number, log_ns


def _learn(raw: bytes) -> MessageHead:
    """Return the layout of a header with number and time."""
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
    """Yield name, offset and size of each field of a valid header."""
    at = 0
    while at < len(raw):
        (length,) = _U32.unpack_from(raw, at)
        name = raw[at + 4 : at + 4 + length].partition(b"=")[0]
        value_at = at + 4 + len(name) + 1
        yield name, value_at, at + 4 + length - value_at
        at += 4 + length
