"""Records in bag chunks: the fast loops of scans, and parsing of selected messages.

The header of a message has always the same fields and the same length, only their order is the writer's. So the
layout is taken from the first message, and every other header is compared with it as a whole.
"""

from __future__ import annotations

import re
import struct
from array import array
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import itemgetter

from kleinkram.recordings.chunk_index_check import ChunkMessages
from kleinkram.recordings.chunk_scanner import ChunkContents, ChunkedFacts, Hole
from kleinkram.recordings.chunk_table import Row
from kleinkram.recordings.compression import Buffer
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.rosbag1 import records
from kleinkram.recordings.formats.rosbag1.records import Connection, Fields, Op
from kleinkram.recordings.limits import MAX_CHUNK_INDEX, MAX_DEFINITIONS, MAX_HEADER, MAX_NAMES, MAX_TAKE, MAX_TOPICS
from kleinkram.recordings.messages import Block, Channel, RawMessage, Schema, Selection
from kleinkram.recordings.scanned_messages import Batch
from kleinkram.recordings.sources import Source
from kleinkram.recordings.streams import open_range

_FIELDS = {b"op": "8s", b"conn": "9sI", b"time": "9sII"}
_VALUES = {b"op": 1, b"conn": 2, b"time": 3}
_HEADER_BYTES = 38
_U32 = struct.Struct("<I")
_HEAD_WINDOW = 4096
_S = 1_000_000_000


class MessageLayout:
    """The order of the fields in message headers, learned from one of them."""

    def __init__(self, order: tuple[bytes, ...], data: Buffer, at: int) -> None:
        self.layout = struct.Struct("<I" + "".join(_FIELDS[name] for name in order) + "I")
        constants, offset = [0], 1
        for name in order:
            constants.append(offset)
            if name == b"conn":
                connection = offset + 1
            elif name == b"time":
                time = offset + 1
            offset += _VALUES[name]
        self.constants: Callable[[tuple[object, ...]], object] = itemgetter(*constants)
        self.expected = self.constants(self.layout.unpack_from(data, at))
        self.values: Callable[[tuple[int, ...]], tuple[int, int, int, int]] = itemgetter(
            connection, time, time + 1, offset
        )

    def read(self, data: Buffer, at: int) -> tuple[int, int, int, int] | None:
        """Return connection, seconds, nanoseconds and data size of a message; None for another record or layout."""
        if at + self.layout.size > len(data):
            return None
        header = self.layout.unpack_from(data, at)
        return self.values(header) if self.constants(header) == self.expected else None


def learn_layout(data: Buffer, at: int) -> MessageLayout | None:
    """Return the layout of the message record at `at`; None if it is unusual."""
    if _U32.unpack_from(data, at)[0] != _HEADER_BYTES:
        return None
    order, offset, end = [], at + _U32.size, at + _U32.size + _HEADER_BYTES
    while offset < end:
        length = int(_U32.unpack_from(data, offset)[0])
        order.append(bytes(data[offset + _U32.size : offset + _U32.size + length]).partition(b"=")[0])
        offset += _U32.size + length
    return MessageLayout(tuple(order), data, at) if sorted(order) == sorted(_FIELDS) else None


def walk_messages(data: Buffer, at: int, end: int, layout: MessageLayout, batch: Batch) -> tuple[int, int]:
    """Add messages from `at` on to the batch, up to another record or one that ends after `end`.

    Returns where that is, and where the last message begins; twice the same without any message.
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
        batch[connection].extend((seconds * _S + nanoseconds, 0, after - at))
        start, at = at, after
    return at, start


_OP = re.compile(rb"\x04\0\0\0op=[\x02-\x07]")
_OP_OUTSIDE = re.compile(rb"\x04\0\0\0op=[\x03-\x06]")
_LONGEST_SEARCHED_HEADER = 512
_MAX_CHECKED = 2


@dataclass
class BagFacts(ChunkedFacts[Connection]):
    """Definitions of a bag. `counts`: messages by connection, by the index; `layout`: of message headers."""

    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))
    layout: MessageLayout | None = None

    def define(self, number: int, connection: Connection, where: str) -> None:
        """Note a connection; the first of a number counts."""
        if number in self.channels:
            return
        self.names_bytes += len(connection.topic) + len(connection.message_type) + len(connection.publisher)
        if len(self.channels) >= MAX_TOPICS or self.names_bytes > MAX_NAMES:
            raise Malformed(where, "more connections than are read", certain=False)
        self.definition_bytes += len(connection.definition)
        fits = self.definition_bytes <= MAX_DEFINITIONS
        self.channels[number] = connection if fits else connection._replace(definition=b"")

    def resolve_channels(self) -> dict[int, Channel]:
        """Return the connections as channels."""
        return {
            number: Channel(
                one.topic, "ros1", Schema(one.message_type, "ros1msg", one.definition), properties=one.properties
            )
            for number, one in self.channels.items()
        }


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
    """Read the header of a record."""
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
    if opcode == Op.MESSAGE_DATA:
        fields.u32("conn"), fields.time_ns("time")
    elif opcode == Op.CONNECTION:
        fields.u32("conn"), fields.text("topic")
    elif opcode == Op.CHUNK:
        if fields.text("compression") == "none" and fields.u32("size") != data_bytes:
            raise Malformed(where, "a chunk whose lengths contradict each other")
    elif opcode == Op.INDEX_DATA:
        if data_bytes != records.INDEX_ENTRY_BYTES * fields.u32("count"):
            raise Malformed(where, "index data whose length does not fit its count")
    elif opcode == Op.CHUNK_INFO and data_bytes != 8 * fields.u32("count"):
        raise Malformed(where, "a chunk info whose length does not fit its count")
    return BagRecord(fields, opcode, at, data_start, data_start + data_bytes)


def find_record(data: Buffer, start: int, end: int, *, outside: bool = False) -> int | None:
    """Return the first offset in [start, end) where a record header begins; `outside`: of a kind outside of chunks."""
    untried = start
    for match in (_OP_OUTSIDE if outside else _OP).finditer(data, start, end):
        field_at = match.start()
        for at in range(field_at - _U32.size, max(untried, field_at - _LONGEST_SEARCHED_HEADER) - 1, -1):
            header_bytes = int(_U32.unpack_from(data, at)[0])
            if field_at + 8 - at - _U32.size <= header_bytes <= _LONGEST_SEARCHED_HEADER and opcode_at(data, at):
                return at
        # An offset that is no record, or whose header ends before this field, is none for a later field either.
        untried = max(untried, field_at - _U32.size + 1)
    return None


def points_at_messages(content: Buffer, number: int, entries: array[int], layout: MessageLayout | None) -> bool:
    """Return whether messages of a connection are where index data say; checks the first, the last and a sample.

    `entries`: seconds, nanoseconds and offset in the chunk of each message.
    """
    count = len(entries) // 3
    for at in {*range(0, count, max(1, count // _MAX_CHECKED)), max(0, count - 1)} if count else ():
        seconds, nanoseconds, offset = entries[3 * at : 3 * at + 3]
        actual = _message_at(content, offset, layout)
        if actual != (number, seconds, nanoseconds):
            return False
    return True


def _message_at(content: Buffer, offset: int, layout: MessageLayout | None) -> tuple[int, int, int] | None:
    """Return connection, seconds and nanoseconds of a message; None for another record."""
    if layout is not None and (known := layout.read(content, offset)):
        return known[:3]
    record = parse_record(content, offset, "")
    if record.opcode != Op.MESSAGE_DATA:
        return None
    seconds, nanoseconds = divmod(record.fields.time_ns("time"), _S)
    return record.fields.u32("conn"), seconds, nanoseconds


def opcode_at(data: Buffer, at: int) -> int | None:
    """Return the type of the record whose header begins here; None if there is none."""
    try:
        return parse_record(data, at, "").opcode
    except Malformed:
        return None


def walk_contents(raw: bytes, facts: BagFacts, batch: Batch, *, may_end_early: bool = False) -> ChunkContents:
    """Add the messages in `raw` to the batch.

    `may_end_early`: bytes of the chunk may be missing, so that `raw` reaches further: to a record that no chunk holds.
    """
    holes: list[Hole] = []
    readable_ranges: list[tuple[int, int]] = []
    at, first, end = 0, 0, len(raw)
    # Where the record before begins; behind a hole: none.
    previous = -1
    while at < end:
        before = at
        if facts.layout is not None:
            at, last = walk_messages(raw, at, end, facts.layout, batch)
            if at == end:
                break
            previous = last if at > before else previous
        try:
            previous, at = at, read_record(raw, at, facts, batch)
        except Malformed as fault:
            readable_ranges.append((first, at))
            if may_end_early and find_record(raw, at, at + _LONGEST_SEARCHED_HEADER, outside=True) == at:
                holes.append(Hole(at, at, Malformed(fault.where, "its end is missing")))
                return ChunkContents(holes, at, tuple(readable_ranges))
            # The length of the record before may be what is wrong.
            record_at = find_record(raw, (at if previous < 0 else previous) + 1, end)
            after = end if record_at is None else record_at
            holes.append(Hole(at, max(at, after), fault))
            first = at = after
            previous = -1
    return ChunkContents(holes, end, (*readable_ranges, (first, end)) if holes else None)


def read_record(data: Buffer, at: int, facts: BagFacts, batch: Batch) -> int:
    """Read one whole connection or message; return where it ends."""
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
    """Note a connection."""
    if record.data_bytes > MAX_TAKE:
        raise Malformed(where, f"a connection of {record.data_bytes} bytes", certain=False)
    number, connection = records.read_connection(record.fields, data, where)
    facts.define(number, connection, where)


def read_message_index(source: Source, row: Row) -> ChunkMessages | None:
    """Return the messages that the index data after a chunk list; None if there are none, or they cannot be read."""
    stream, messages = open_range(source, row.start, row.end, window=_HEAD_WINDOW), ChunkMessages()
    try:
        stream.skip(records.open_chunk(stream).stored_bytes)
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
    """Return the selected messages of records, in file order."""
    _, start_ns, end_ns = selection
    view = content if isinstance(content, bytes) else bytes(content)
    at, size, new = 0, len(view), tuple.__new__
    layout: MessageLayout | None = None
    messages: Block = []
    while at + 8 <= size:
        number, log_ns = -1, 0
        known = layout.read(view, at) if layout is not None else None
        if layout is not None and known is not None:
            number, seconds, nanoseconds, data_bytes = known
            log_ns, data_at = seconds * _S + nanoseconds, at + layout.layout.size
        else:
            (length,) = _U32.unpack_from(view, at)
            data_at = at + 8 + length
            if length > MAX_HEADER or data_at > size:
                raise Malformed(f"byte {at} of the chunk", "a record that reaches beyond the chunk")
            fields = Fields(view[at + 4 : data_at - 4], f"byte {at} of the chunk")
            (data_bytes,) = _U32.unpack_from(view, data_at - 4)
            if fields.opcode() == Op.MESSAGE_DATA:
                number, log_ns = fields.u32("conn"), fields.time_ns("time")
                layout = learn_layout(view, at)
        end = data_at + data_bytes
        if end > size:
            raise Malformed(f"byte {at} of the chunk", "a record that reaches beyond the chunk")
        channel = channels.get(number)
        if channel is not None and start_ns <= log_ns < end_ns:
            messages.append(new(RawMessage, (channel.topic, log_ns, log_ns, 0, view[data_at:end], channel)))
        at = end
    if at != size:
        raise Malformed(f"byte {at} of the chunk", "a record that ends before its fields")
    return messages
