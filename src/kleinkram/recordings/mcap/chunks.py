"""One chunk of an MCAP: what stands in it, proven by its CRC before anything of it is believed."""

from __future__ import annotations

import struct
import zlib
from typing import NamedTuple

from kleinkram.recordings.decompress import Buffer, decompress, decompress_beginning
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_AT_ONCE, MAX_TAKE, WINDOW
from kleinkram.recordings.listening import Place
from kleinkram.recordings.mcap import records
from kleinkram.recordings.mcap.plausible import CHUNK_FIXED
from kleinkram.recordings.mcap.records import RECORD_HEAD, McapFacts
from kleinkram.recordings.mcap.walking import MESSAGE_FIXED, MESSAGE_HEAD, walk_messages
from kleinkram.recordings.stream import Lookahead
from kleinkram.recordings.tally import Batch

_U64 = struct.Struct("<Q")
_DEFINITIONS = {records.SCHEMA: records.read_schema, records.CHANNEL: records.read_channel}
HEAD_OF_DEFINITION = 3 * 4096 + 16


class ChunkHead(NamedTuple):
    """The fixed fields of a chunk record; `data_start` counts from the record's own start."""

    compression: str
    uncompressed: int
    crc: int
    data_start: int
    stored: int
    first_ns: int
    last_ns: int
    is_unfinished: bool = False


class Contents(NamedTuple):
    """What a walk through the records of a chunk came to.

    Attributes:
        walked: bytes of records that could be followed.
        fault: why it ended there; None: at the end.
        raw: the content of a whole chunk.
    """

    walked: int
    fault: Malformed | None = None
    raw: bytes = b""


def read_chunk_head(data: Buffer, at: int) -> ChunkHead:
    """Read the head of a chunk record whose lengths are known to agree, or that was never finished."""
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
        uncompressed, crc = records.UNFINISHED_CHUNK_BYTES, 0
    return ChunkHead(name, uncompressed, crc, data_start, stored, first_ns, last_ns, is_unfinished=True)


def with_known_size(head: ChunkHead, stored: bytes) -> ChunkHead:
    """Return the head of an unfinished chunk with the size of what its stored bytes hold, where that can be held."""
    if head.uncompressed != records.UNFINISHED_CHUNK_BYTES or not head.is_unfinished:
        return head
    size = len(decompress_beginning(head.compression, stored, MAX_AT_ONCE))
    return head._replace(uncompressed=size) if size < MAX_AT_ONCE - WINDOW else head


def read_chunk(stored: Buffer, head: ChunkHead, facts: McapFacts, batch: Batch) -> Contents:
    """Add the messages of a whole chunk to the batch.

    Raises:
        Malformed: nothing in it can be believed.
    """
    raw = decompress(head.compression, stored, head.uncompressed)
    if head.crc and zlib.crc32(raw) != head.crc:
        raise Malformed("chunk", "its checksum is wrong")
    return walk_contents(raw, facts, batch)._replace(raw=raw)


def read_beginning(stored: bytes, head: ChunkHead, facts: McapFacts, batch: Batch) -> tuple[int, int]:
    """Add the messages of a chunk whose end is missing; return how many of the `stored` bytes they stand in, and how
    many of the content.
    """
    raw = decompress_beginning(head.compression, stored, head.uncompressed)
    walked = walk_contents(raw, facts, batch).walked
    return (len(stored) * walked // len(raw) if raw else 0), walked


def tell(facts: McapFacts, place: Place, batch: Batch) -> None:
    """Tell the listener, if there is one, of messages at a place."""
    if facts.listener is not None:
        facts.listener.hear(place, batch)


def tell_definition(stream: Lookahead, facts: McapFacts, opcode: int, where: str) -> None:
    """Tell the listener, if there is one, of the next record, if it is a definition outside of chunks."""
    if facts.listener is not None and opcode in (records.SCHEMA, records.CHANNEL):
        _, length = RECORD_HEAD.unpack_from(stream.window, stream.at)
        most = RECORD_HEAD.size + min(length, MAX_TAKE)
        stream.ahead(most)
        facts.listener.define(opcode, bytes(stream.window[stream.at + RECORD_HEAD.size : stream.at + most]), where)


def walk_contents(raw: bytes, facts: McapFacts, batch: Batch) -> Contents:
    """Add the messages of records to the batch, as far as they can be followed."""
    at, end = 0, len(raw)
    while True:
        at, _ = walk_messages(raw, at, end, batch)
        if at == end:
            return Contents(at)
        if end - at < RECORD_HEAD.size:
            return Contents(at, Malformed(f"byte {at}", "it ends within a record"))
        opcode, length = RECORD_HEAD.unpack_from(raw, at)
        body = at + RECORD_HEAD.size
        if opcode in (0, records.MESSAGE) or body + length > end:
            return Contents(at, Malformed(f"byte {at}", "its records break off"))
        if opcode in _DEFINITIONS:
            try:
                _define(facts, opcode, raw[body : body + _most_of_definition(facts, length)], f"byte {at}")
            except Malformed as fault:
                return Contents(at, fault)
        at = body + length


def read_definition(inner: Lookahead, facts: McapFacts, opcode: int, length: int) -> None:
    """Note the next record of a chunk's content if it is a definition."""
    if opcode in _DEFINITIONS:
        most = _most_of_definition(facts, length)
        inner.ahead(RECORD_HEAD.size + most)
        body = inner.at + RECORD_HEAD.size
        _define(facts, opcode, bytes(inner.window[body : body + most]), f"byte {inner.position}")


def _most_of_definition(facts: McapFacts, length: int) -> int:
    """Return how much of a definition is looked at: its names, or all of it for a listener."""
    return min(length, HEAD_OF_DEFINITION if facts.listener is None else MAX_TAKE)


def _define(facts: McapFacts, opcode: int, body: bytes, where: str) -> None:
    _DEFINITIONS[opcode](facts, body, where)
    if facts.listener is not None:
        facts.listener.define(opcode, body, where)


def read_large_message(stream: Lookahead) -> tuple[int, tuple[int, int, int]]:
    """Return channel and row of the next message, of which only the head is at hand.

    Raises:
        Malformed: it is too short to be one.
    """
    head = stream.window[stream.at : stream.at + MESSAGE_HEAD.size]
    if len(head) < MESSAGE_HEAD.size or MESSAGE_HEAD.unpack(head)[1] < MESSAGE_FIXED:
        raise Malformed(f"byte {stream.position}", "a message that is too short to be one")
    _opcode, length, channel_id, _sequence, log_time, publish_time = MESSAGE_HEAD.unpack(head)
    return channel_id, (log_time, publish_time, RECORD_HEAD.size + length)
