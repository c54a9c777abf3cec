"""Could a record of MCAP begin here? What a scan asks of each record, and, more strictly, where it looks for the next
one behind damage.

Looks at the bytes at hand only; decompresses nothing, keeps nothing.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Container

from kleinkram.recordings.compression import Buffer
from kleinkram.recordings.damage_report import DamageReport
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import FOOTER_BYTES, HEADER, MAGIC, RECORD_HEAD
from kleinkram.recordings.limits import MAX_NAME
from kleinkram.recordings.streams import LookaheadStream

LOOK = 64 * 2**10
"""Bytes from the start of a record within which its fixed fields and names stand."""

CHUNK_FIXED = struct.Struct("<QQQII")
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_MESSAGE_BYTES = 22
_LONGEST_COMPRESSION = 64
_FIRST_PRIVATE = 0x80
_FOLLOWERS, _FOLLOWERS_OF_STRANGER = 1, 4
_ONE_BIT_AWAY = (records.HEADER, records.CHANNEL, records.METADATA_INDEX)
_COMPRESSIONS = (b"", b"zstd", b"lz4")
_CANDIDATE = re.compile(rb"[\x01-\x0f](?=.{5}\0{3})", re.DOTALL)
"""An opcode, and the length of a record below 1 TB."""
_CHUNK = re.compile(rb"\x06(?=.{5}\0{3})", re.DOTALL)


def record_end(data: Buffer, at: int, left: int) -> int | None:
    """Return where the record at `at` ends if all its lengths agree; `left`: bytes to the end of the file.

    For records that are found by chance: fields behind those that the specification knows are not allowed.
    """
    if at + RECORD_HEAD.size > len(data):
        return None
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    body = at + RECORD_HEAD.size
    if opcode not in _NEEDED or RECORD_HEAD.size + length > left:
        return None
    return body + length if _needs(opcode, data, body, length) == length else None


def stands_outside_chunks(data: Buffer, at: int, left: int) -> bool:
    """Say whether a record stands there of a kind that no chunk holds."""
    inside = (records.SCHEMA, records.CHANNEL, records.MESSAGE)
    return record_end(data, at, left) is not None and data[at] not in inside


def no_record(head: Buffer) -> str:
    """Say what stands where a record should begin: `head`, which is none."""
    return "no record where one should begin" if any(head) else "zeros where a record should begin"


def fault(data: Buffer, at: int, left: int) -> str | None:
    """Say what is wrong with a record that stands where one should; None: it can be followed.

    `left`: bytes from `at` to the end of the file. A record of a kind that we do not know must be followed by one that
    we do, or by another of a private kind; and unless it is of a private kind itself, no chunk may begin near its head.
    """
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    is_known = opcode in _NEEDED
    if opcode == 0 or (not is_known and not _is_unknown_kind(data, at, length, left)):
        return no_record(data[at : at + RECORD_HEAD.size])
    if not is_known or opcode == records.MESSAGE:
        return None
    if is_unfinished_chunk(data, at):
        return None
    needed = _needs(opcode, data, at + RECORD_HEAD.size, length)
    # Later versions may add fields to a record. Not to a chunk, which ends in data of a length that stands before it.
    if needed is None or needed > length or (opcode == records.CHUNK and needed != length):
        return "a record whose lengths contradict each other"
    if (
        needed < length
        and record_end(data, at + RECORD_HEAD.size + needed, left - RECORD_HEAD.size - needed) is not None
    ):
        return "a record that is said to be so long that it holds the next one, too"
    return None


def is_unfinished_chunk(data: Buffer, at: int) -> bool:
    """Say whether a chunk was begun there whose lengths were never filled in.

    Only its data's length, or also that of the record: the recorder writes both once the chunk is complete.
    """
    if at + RECORD_HEAD.size + CHUNK_FIXED.size > len(data):
        return False
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    fixed_at = at + RECORD_HEAD.size
    _first, _last, uncompressed, _crc, name_length = CHUNK_FIXED.unpack_from(data, fixed_at)
    stored_at = fixed_at + CHUNK_FIXED.size + name_length
    if opcode != records.CHUNK or name_length > _LONGEST_COMPRESSION or stored_at + _U64.size > len(data):
        return False
    (stored,) = _U64.unpack_from(data, stored_at)
    return records.PLACEHOLDER in (length, uncompressed, stored)


def is_disguised(data: Buffer, at: int, left: int, *, behind_chunk: bool) -> bool:
    """Say whether what claims to be a message has the lengths of a record whose opcode is one bit away from that.

    `left`: bytes from `at` to the end of the file. `behind_chunk`: or behind damage, where message indexes
    may stand; a message elsewhere may look like one by chance.
    """
    if left < RECORD_HEAD.size:
        return False
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    if opcode != records.MESSAGE or length > left - RECORD_HEAD.size:
        return False
    kinds = (*_ONE_BIT_AWAY, records.MESSAGE_INDEX) if behind_chunk else _ONE_BIT_AWAY
    return any(_needs(kind, data, at + RECORD_HEAD.size, length) == length for kind in kinds)


def _needs(opcode: int, data: Buffer, body: int, length: int) -> int | None:
    """Return how many bytes a record of a kind has, as its lengths say; None: they make no sense."""
    try:
        return _NEEDED[opcode](data, body, length)
    except struct.error:
        return None


def fault_at_hand(data: Buffer, at: int, left: int) -> str | None:
    """Say why no record can begin at a place; None where one can, or where it is not at hand."""
    if at + min(LOOK, left) > len(data) or left < RECORD_HEAD.size:
        return None
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    if length > left - RECORD_HEAD.size and opcode != records.CHUNK:
        return "a record that reaches beyond the end of the file"
    return fault(data, at, left)


def _is_unknown_kind(data: Buffer, at: int, length: int, left: int) -> bool:
    body, left_after_head = at + RECORD_HEAD.size, left - RECORD_HEAD.size
    after, left = body + length, left_after_head - length
    if left < 0 or (data[at] < _FIRST_PRIVATE and holds_chunk(data, body, min(after, body + LOOK), left_after_head)):
        return False
    if left < RECORD_HEAD.size or after + min(LOOK, left) > len(data):
        return True
    opcode, following = RECORD_HEAD.unpack_from(data, after)
    is_private = opcode >= _FIRST_PRIVATE and RECORD_HEAD.size + following <= left
    # A message index follows a chunk: what stands before it is one whose beginning is lost.
    return is_private or (opcode != records.MESSAGE_INDEX and record_end(data, after, left) is not None)


def find_record(data: Buffer, start: int, end: int, left: int, channels: Container[int]) -> int | None:
    """Return the first place in [start, end) where a record stands.

    `left`: bytes from `start` to the end of the file. The lengths in a record vouch for it. Those of a message are too
    few: another record must follow, and several if it is of none of the `channels`.
    """
    for match in _CANDIDATE.finditer(data, start, end):
        at = match.start()
        after = record_end(data, at, left - (at - start))
        if after is None:
            continue
        if data[at] != records.MESSAGE:
            return at
        (channel_id,) = _U16.unpack_from(data, at + RECORD_HEAD.size)
        needed = _FOLLOWERS if channel_id in channels else _FOLLOWERS_OF_STRANGER
        if _is_followed(data, after, left - (after - start), needed):
            return at
    return None


def holds_chunk(data: Buffer, start: int, end: int, left: int) -> bool:
    """Say whether a chunk begins in [start, end); `left`: bytes from `start` to the end of the file."""
    places = (match.start() for match in _CHUNK.finditer(data, start, end))
    return any(record_end(data, at, left - (at - start)) is not None for at in places)


def _is_followed(data: Buffer, at: int, left: int, records_needed: int) -> bool:
    """Say whether so many records follow, or fewer up to the end of the file."""
    for _ in range(records_needed):
        if left == 0:
            return True
        after = record_end(data, at, left)
        if after is None:
            return False
        at, left = after, left - (after - at)
    return True


def _counted(data: Buffer, at: int) -> int:
    """Return where a string, map or array that begins with its length ends."""
    return at + _U32.size + int(_U32.unpack_from(data, at)[0])


def _need_message(data: Buffer, at: int, length: int) -> int | None:
    return max(length, _MESSAGE_BYTES)


def _need_chunk(data: Buffer, at: int, length: int) -> int | None:
    (name_length,) = _U32.unpack_from(data, at + CHUNK_FIXED.size - _U32.size)
    if name_length > MAX_NAME:
        return None
    stored_at = at + CHUNK_FIXED.size + name_length
    (stored,) = _U64.unpack_from(data, stored_at)
    return int(stored_at + _U64.size + stored - at)


def _need_schema(data: Buffer, at: int, length: int) -> int | None:
    name_end = _counted(data, at + _U16.size)
    return _counted(data, _counted(data, name_end)) - at


def _need_channel(data: Buffer, at: int, length: int) -> int | None:
    topic_end = _counted(data, at + 2 * _U16.size)
    return _counted(data, _counted(data, topic_end)) - at


def _need_message_index(data: Buffer, at: int, length: int) -> int | None:
    end = _counted(data, at + _U16.size)
    return None if (end - at - _U16.size - _U32.size) % 16 else end - at


def _need_chunk_index(data: Buffer, at: int, length: int) -> int | None:
    name_at = _counted(data, at + 4 * _U64.size) + _U64.size
    return _counted(data, name_at) + 2 * _U64.size - at


def _need_attachment(data: Buffer, at: int, length: int) -> int | None:
    size_at = _counted(data, _counted(data, at + 2 * _U64.size))
    size: int = _U64.unpack_from(data, size_at)[0]
    return size_at + _U64.size + size + _U32.size - at


def _need_attachment_index(data: Buffer, at: int, length: int) -> int | None:
    return _counted(data, _counted(data, at + 5 * _U64.size)) - at


def _need_statistics(data: Buffer, at: int, length: int) -> int | None:
    end = _counted(data, at + records.STATISTICS_BODY.size)
    return None if (end - at - records.STATISTICS_BODY.size - _U32.size) % 10 else end - at


def _need_metadata(data: Buffer, at: int, length: int) -> int | None:
    return _counted(data, _counted(data, at)) - at


def _need_metadata_index(data: Buffer, at: int, length: int) -> int | None:
    return _counted(data, at + 2 * _U64.size) - at


def _need_header(data: Buffer, at: int, length: int) -> int | None:
    return _counted(data, _counted(data, at)) - at


def _need_footer(data: Buffer, at: int, length: int) -> int | None:
    end = at + records.FOOTER_BODY.size
    return records.FOOTER_BODY.size if data[end : end + len(records.MAGIC)] == records.MAGIC else None


_NEEDED: dict[int, Callable[[Buffer, int, int], int | None]] = {
    records.HEADER: _need_header,
    records.FOOTER: _need_footer,
    records.SCHEMA: _need_schema,
    records.CHANNEL: _need_channel,
    records.MESSAGE: _need_message,
    records.CHUNK: _need_chunk,
    records.MESSAGE_INDEX: _need_message_index,
    records.CHUNK_INDEX: _need_chunk_index,
    records.ATTACHMENT: _need_attachment,
    records.ATTACHMENT_INDEX: _need_attachment_index,
    records.STATISTICS: _need_statistics,
    records.METADATA: _need_metadata,
    records.METADATA_INDEX: _need_metadata_index,
    records.SUMMARY_OFFSET: lambda data, at, length: 1 + 2 * _U64.size,
    records.DATA_END: lambda data, at, length: _U32.size,
}


_SEARCH_BYTES = 4 * 2**20
_END = rb"\x02\x14\0{7}.{20}" + re.escape(MAGIC)
"""A footer, and the magic behind it."""
_MARK = re.compile(_END + b"|" + re.escape(MAGIC), re.DOTALL)


def pass_damage(stream: LookaheadStream, channels: Container[int], losses: DamageReport) -> None:
    """Pass over at least one byte, up to the next place where a record of this file stands."""
    start = 0 if stream.window[stream.at] == HEADER and stream.position != len(MAGIC) else 1
    while stream.left:
        width = _bring(stream)
        at, end = stream.at, stream.at + width
        record_at = find_record(stream.window, at + start, end, stream.left - start, channels)
        inner = find_inner(stream.window, at, end if record_at is None else record_at, stream.left)
        if inner is None and record_at is not None and stream.window[record_at] == HEADER:
            inner = record_at
        start = 0
        if inner is not None:
            stream.advance(inner - at)
            _pass_inner(stream, losses)
            continue
        stream.advance(width if record_at is None else record_at - at)
        if record_at is not None:
            return


def find_inner(data: Buffer, start: int, end: int, left: int) -> int | None:
    """Return the first place in [start, end) where another MCAP begins; `left`: bytes from `start` to the end of the
    file, whose last magic is its own.
    """
    for match in _MARK.finditer(data, start, min(len(data), end + FOOTER_BYTES)):
        if match.start() >= end:
            return None
        if _opens(match) and match.end() - start < left:
            return match.start()
    return None


def _bring(stream: LookaheadStream) -> int:
    """Bring bytes into the window; return how many of them a record or magic may begin in that is there as a whole."""
    at_hand = stream.ahead(_SEARCH_BYTES)
    return at_hand if at_hand == stream.left else at_hand - LOOK


def _opens(match: re.Match[bytes]) -> bool:
    return match.end() - match.start() == len(MAGIC)


def _pass_inner(stream: LookaheadStream, losses: DamageReport) -> None:
    """Pass over another file, which begins here, and over those in it."""
    message = "another MCAP begins inside of this one; what stands in it is not counted"
    losses.note(Malformed(f"byte {stream.position}", message))
    depth = 1
    stream.advance(1)
    while stream.left and depth:
        width = _bring(stream)
        end = min(len(stream.window), stream.at + width + FOOTER_BYTES)
        match = _MARK.search(stream.window, stream.at, end)
        if match is None or match.start() >= stream.at + width:
            stream.advance(width)
            continue
        depth += 1 if _opens(match) else -1
        stream.advance(match.end() - stream.at)
