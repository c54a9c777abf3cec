"""What stands in one chunk of a bag: connections and messages, followed from record to record.

Nothing in a bag vouches for a chunk that is not compressed. So a record that cannot be one is passed over, up to the
next place where one stands.
"""

from __future__ import annotations

import re
import struct
from array import array
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

from kleinkram.recordings.bag import records
from kleinkram.recordings.bag.records import Connection, Fields
from kleinkram.recordings.bag.walking import MessageLayout, learn_layout, walk_messages
from kleinkram.recordings.decompress import Buffer
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_HEADER, MAX_NAMES, MAX_TAKE, MAX_TOPICS
from kleinkram.recordings.listening import Held, Listener, Stretches
from kleinkram.recordings.tally import Batch

_U32 = struct.Struct("<I")
_OP = re.compile(rb"\x04\0\0\0op=[\x02-\x07]")
_OP_OUTSIDE = re.compile(rb"\x04\0\0\0op=[\x03-\x06]")
_LONGEST_SEARCHED_HEADER = 512
_MOST_CHECKED = 2


class BagListener(Listener, Protocol):
    """Is told of definitions, too."""

    def define(self, fields: Fields, data: bytes, where: str, /) -> None:
        """Take note of a connection."""


@dataclass
class BagFacts:
    """What the records of a bag said so far.

    Attributes:
        listener: is told of what the facts leave out: the text of definitions, and where the messages stand.
    """

    connections: dict[int, Connection] = field(default_factory=dict)
    names_bytes: int = 0
    layout: MessageLayout | None = None
    listener: BagListener | None = None

    def fork(self) -> BagFacts:
        """Return a copy: what a chunk defines in one is not in the other, and its listener is not told of it yet."""
        listener = None if self.listener is None else Held[Fields](self.listener)
        return replace(self, connections=dict(self.connections), listener=listener)

    def adopt(self, fork: BagFacts) -> None:
        """Believe what a chunk has defined in a copy of this one."""
        self.connections.update(fork.connections)
        self.names_bytes, self.layout = fork.names_bytes, fork.layout
        if isinstance(fork.listener, Held):
            fork.listener.release()

    def define(self, number: int, connection: Connection, where: str) -> None:
        """Note a connection; the first of a number counts."""
        if number in self.connections:
            return
        self.names_bytes += len(connection.topic) + len(connection.message_type) + len(connection.publisher)
        if len(self.connections) >= MAX_TOPICS or self.names_bytes > MAX_NAMES:
            raise Malformed(where, "more connections than are read", certain=False)
        self.connections[number] = connection


class Hole(NamedTuple):
    """Bytes of a chunk that were passed over: [start, end)."""

    start: int
    end: int
    fault: Malformed


class Contents(NamedTuple):
    """What a walk through the records of a chunk came to; `end`: of the chunk, in its bytes.

    `stretches`: those in which the records follow each other. Behind a message whose length is wrong they overlap.
    """

    holes: list[Hole]
    end: int
    stretches: Stretches


@dataclass(frozen=True)
class Record:
    """A record whose header is at hand; `start`, `data_start`, `end`: places in the bytes in which it was found."""

    fields: Fields
    opcode: int
    start: int
    data_start: int
    end: int

    @property
    def data_bytes(self) -> int:
        """Length of the data."""
        return self.end - self.data_start


def parse_record(data: Buffer, at: int, where: str) -> Record:
    """Read the header of a record.

    Raises:
        Malformed: there is none, or it is not wholly at hand.
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
    if not records.MESSAGE <= opcode <= records.CONNECTION:
        raise Malformed(where, f"a record of type {opcode}, which no bag has")
    data_start = header_at + header_bytes + _U32.size
    data_bytes = int(_U32.unpack_from(data, data_start - _U32.size)[0])
    record = Record(fields, opcode, at, data_start, data_start + data_bytes)
    _check_lengths(record, where)
    return record


def _check_lengths(record: Record, where: str) -> None:
    fields, data_bytes = record.fields, record.data_bytes
    if record.opcode == records.MESSAGE:
        fields.u32("conn"), fields.time_ns("time")
    elif record.opcode == records.CONNECTION:
        fields.u32("conn"), fields.text("topic")
    elif record.opcode == records.CHUNK:
        if fields.text("compression") == "none" and fields.u32("size") != data_bytes:
            raise Malformed(where, "a chunk whose lengths contradict each other")
    elif record.opcode == records.INDEX_DATA:
        if data_bytes != records.INDEX_ENTRY_BYTES * fields.u32("count"):
            raise Malformed(where, "index data whose length does not fit its count")
    elif record.opcode == records.CHUNK_INFO and data_bytes != 8 * fields.u32("count"):
        raise Malformed(where, "a chunk info whose length does not fit its count")


def find_record(data: Buffer, start: int, end: int, *, outside: bool = False) -> int | None:
    """Return the first place in [start, end) where the header of a record stands, whose field `op` is in there too.

    `outside`: only records of the kinds that stand outside of chunks.
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
    """Say whether messages of a connection stand where index data say; looks at a few, the first and last among them.

    `entries`: seconds, nanoseconds and place in the chunk of each message.

    Raises:
        Malformed: no record stands at one of the places.
    """
    count = len(entries) // 3
    for at in {*range(0, count, max(1, count // _MOST_CHECKED)), max(0, count - 1)} if count else ():
        seconds, nanoseconds, place = entries[3 * at : 3 * at + 3]
        found = _message_at(content, place, layout)
        if found != (number, seconds, nanoseconds):
            return False
    return True


def _message_at(content: Buffer, place: int, layout: MessageLayout | None) -> tuple[int, int, int] | None:
    """Return connection, seconds and nanoseconds of the message at a place; None of another record."""
    if layout is not None and place + layout.layout.size <= len(content):
        fields = layout.layout.unpack_from(content, place)
        if layout.constants(fields) == layout.expected:
            return layout.values(fields)[:3]
    record = parse_record(content, place, "")
    if record.opcode != records.MESSAGE:
        return None
    seconds, nanoseconds = divmod(record.fields.time_ns("time"), 10**9)
    return record.fields.u32("conn"), seconds, nanoseconds


def is_record(data: Buffer, at: int) -> bool:
    """Say whether the header of a record stands there."""
    try:
        parse_record(data, at, "")
    except Malformed:
        return False
    return True


def stands_outside_chunks(data: Buffer, at: int) -> bool:
    """Say whether the header of a record stands there that can follow a chunk: a message stands inside of one."""
    try:
        return parse_record(data, at, "").opcode != records.MESSAGE
    except Malformed:
        return False


def read_contents(raw: bytes, facts: BagFacts, batch: Batch, *, ends_early: bool = False) -> Contents:
    """Add the messages in `raw` to the batch.

    `ends_early`: `raw` may reach further than the chunk does, because bytes of it are missing: it ends where a record
    stands that no chunk holds.
    """
    holes: list[Hole] = []
    stretches: list[tuple[int, int]] = []
    at, end = 0, len(raw)
    first = at
    # Where the record before begins; behind a hole: none.
    previous = -1
    while at < end:
        before = at
        at, last = walk(raw, at, end, facts, batch)
        if at == end:
            break
        previous = last if at > before else previous
        try:
            previous, at = at, read_record(raw, at, facts, batch)
        except Malformed as fault:
            stretches.append((first, at))
            if ends_early and find_record(raw, at, at + _LONGEST_SEARCHED_HEADER, outside=True) == at:
                holes.append(Hole(at, at, Malformed(fault.where, "its end is missing")))
                return Contents(holes, at, tuple(stretches))
            # The length of the record before may be what is wrong.
            found = find_record(raw, (at if previous < 0 else previous) + 1, end)
            after = end if found is None else found
            holes.append(Hole(at, max(at, after), fault))
            first = at = after
            previous = -1
    return Contents(holes, end, (*stretches, (first, end)))


def walk(data: Buffer, at: int, end: int, facts: BagFacts, batch: Batch) -> tuple[int, int]:
    """Pass over messages of the layout that is known; return where that ends, and where the last of them begins."""
    return walk_messages(data, at, end, facts.layout, batch) if facts.layout else (at, at)


def read_record(data: Buffer, at: int, facts: BagFacts, batch: Batch) -> int:
    """Read one connection or message that is wholly at hand; return where it ends.

    Raises:
        Malformed: it is neither, or not all there.
    """
    where = f"byte {at} of its contents"
    record = parse_record(data, at, where)
    if record.end > len(data):
        raise Malformed(where, "a record reaches beyond the end")
    if record.opcode == records.CONNECTION:
        define(record, bytes(data[record.data_start : record.end]), facts, where)
    elif record.opcode == records.MESSAGE:
        add_message(record, batch)
        if facts.layout is None:
            facts.layout = learn_layout(data, at)
    else:
        raise Malformed(where, f"a record of type {record.opcode} in a chunk")
    return record.end


def add_message(record: Record, batch: Batch) -> None:
    """Add one message to the batch."""
    row = (record.fields.time_ns("time"), 0, record.end - record.start)
    batch[record.fields.u32("conn")].extend(row)


def define(record: Record, data: bytes, facts: BagFacts, where: str) -> None:
    """Note a connection.

    Raises:
        Malformed: it is damaged, or larger than is read.
    """
    if record.data_bytes > MAX_TAKE:
        raise Malformed(where, f"a connection of {record.data_bytes} bytes", certain=False)
    number, connection = records.read_connection(record.fields, data, where)
    facts.define(number, connection, where)
    if facts.listener is not None:
        facts.listener.define(record.fields, data, where)
