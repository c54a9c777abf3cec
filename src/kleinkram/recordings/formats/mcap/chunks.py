"""Messages in MCAP chunks: the fast loops of scans, and parsing of selected messages."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable, Mapping
from itertools import repeat
from operator import eq

from kleinkram.recordings.chunk_index_check import ChunkMessages
from kleinkram.recordings.chunk_scanner import ChunkContents, Hole
from kleinkram.recordings.chunk_table import ChunkHead, Row
from kleinkram.recordings.compression import Buffer
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import RECORD_HEAD, McapFacts, Opcode
from kleinkram.recordings.formats.mcap.resync import CHUNK_FIXED
from kleinkram.recordings.limits import MAX_CHUNK_BYTES, MAX_CHUNK_INDEX, MAX_NAME, MAX_TAKE
from kleinkram.recordings.messages import Block, Channel, RawMessage, Selection
from kleinkram.recordings.scanned_messages import Batch
from kleinkram.recordings.sources import Source
from kleinkram.recordings.streams import ByteStream, open_range

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
MESSAGE_FIXED = MESSAGE_HEAD.size - RECORD_HEAD.size
_MESSAGE_OPCODE = int(Opcode.MESSAGE)  # faster to compare with than a member of an enum
_INDEXED_HEAD = struct.Struct("<B8xH4xQ")
_U64 = struct.Struct("<Q")
_DEFINITIONS = {Opcode.SCHEMA: records.read_schema, Opcode.CHANNEL: records.read_channel}


def points_at_messages(content: bytes, channel_id: int, stamps: Iterable[int], offsets: array[int]) -> bool:
    """Return whether the messages of a channel with these log times are at these offsets of a chunk."""
    if offsets and max(offsets) > len(content) - MESSAGE_HEAD.size:
        return False
    heads = map(_INDEXED_HEAD.unpack_from, repeat(content), offsets)
    return all(map(eq, heads, zip(repeat(_MESSAGE_OPCODE), repeat(channel_id), stamps)))  # repeat never ends


def walk_messages(data: Buffer, at: int, end: int, batch: Batch) -> tuple[int, int]:
    """Add messages from `at` on to the batch, up to another record or one that ends after `end`.

    Returns where that is, and where the last message begins; twice the same without any message.
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


def walk_contents(raw: bytes, facts: McapFacts, batch: Batch) -> ChunkContents:
    """Add the messages of records to the batch, up to the first damage."""
    at, end = 0, len(raw)
    fault: Malformed | None = None
    while fault is None:
        at, _ = walk_messages(raw, at, end, batch)
        if at == end:
            return ChunkContents([], end)
        if end - at < RECORD_HEAD.size:
            fault = Malformed(f"byte {at}", "it ends within a record")
            break
        opcode, length = RECORD_HEAD.unpack_from(raw, at)
        body = at + RECORD_HEAD.size
        if opcode in (0, Opcode.MESSAGE) or body + length > end:
            fault = Malformed(f"byte {at}", "its records break off")
        elif opcode in _DEFINITIONS:
            try:
                _DEFINITIONS[opcode](facts, raw[body : body + min(length, MAX_TAKE)], f"byte {at}")
            except Malformed as error:
                fault = error
        at = at if fault else body + length
    return ChunkContents([Hole(at, end, fault)], end, ((0, at),))


def open_chunk(stream: ByteStream) -> ChunkHead:
    """Read a chunk record up to its stored bytes."""
    start = stream.position
    opcode, length = RECORD_HEAD.unpack(stream.take(RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise Malformed(f"byte {start}", f"a record of type {opcode} where a chunk should be")
    where, end = f"byte {stream.position}", stream.position + length
    first_ns, last_ns, uncompressed, crc, name_length = CHUNK_FIXED.unpack(stream.take(CHUNK_FIXED.size))
    if name_length > MAX_NAME:
        raise Malformed(where, f"the name of its compression has {name_length} bytes")
    name = stream.take(name_length).decode("utf-8", "replace")
    (stored,) = _U64.unpack(stream.take(_U64.size))
    is_unfinished = records.PLACEHOLDER in (length, uncompressed, stored)
    if uncompressed == records.PLACEHOLDER:
        uncompressed, crc = MAX_CHUNK_BYTES, 0
    if stored != end - stream.position and not is_unfinished:
        raise Malformed(where, f"{stored} bytes are claimed, {end - stream.position} are there")
    times = first_ns, last_ns
    return ChunkHead(name, uncompressed, crc, stream.position - start, stored, times, is_unfinished)


def read_message_index(source: Source, row: Row) -> ChunkMessages | None:
    """Return the messages that the indexes after a chunk list; None if there are none, or they cannot be read."""
    index_start = row.start + row.length
    if not 0 < row.end - index_start <= MAX_CHUNK_INDEX:
        return None
    messages = ChunkMessages()
    try:
        for channel_id, stamps, _offsets in records.read_message_indexes(open_range(source, index_start, row.end)):
            messages.add_index(channel_id, stamps)
    except Malformed:
        return None
    return messages


def parse_messages(content: Buffer, channels: Mapping[int, Channel], selection: Selection) -> Block:
    """Return the selected messages of records, in file order."""
    _, start_ns, end_ns = selection
    view = content if isinstance(content, bytes) else bytes(content)
    unpack, message, channel_of, new = MESSAGE_HEAD.unpack_from, _MESSAGE_OPCODE, channels.get, tuple.__new__
    at, size = 0, len(view)
    last = size - MESSAGE_HEAD.size
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
    while at + RECORD_HEAD.size <= size and view[at] != message:  # records that are shorter than any message
        at += RECORD_HEAD.size + RECORD_HEAD.unpack_from(view, at)[1]
    if at != size:
        raise Malformed(f"byte {at} of the chunk", "a record that reaches beyond the chunk")
    return messages
