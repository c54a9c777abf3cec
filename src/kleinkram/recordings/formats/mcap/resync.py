"""Validates MCAP records by the lengths inside them, and finds the next record after damage.

Looks at the bytes in memory only; decompresses nothing, keeps nothing.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Container
from typing import NamedTuple

from kleinkram.recordings.chunk_scanner import LOOK, search_width
from kleinkram.recordings.compression import Buffer
from kleinkram.recordings.damage_report import DamageReport
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.formats.mcap import records
from kleinkram.recordings.formats.mcap.records import FOOTER_BYTES, MAGIC, RECORD_HEAD, Opcode
from kleinkram.recordings.limits import MAX_NAME
from kleinkram.recordings.streams import LookaheadStream

CHUNK_FIXED = struct.Struct("<QQQII")
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_MESSAGE_BYTES = 22
_LONGEST_COMPRESSION = 64
_FIRST_PRIVATE = 0x80
_FOLLOWERS, _FOLLOWERS_OF_UNKNOWN_CHANNEL = 1, 4
_ONE_BIT_AWAY = (Opcode.HEADER, Opcode.CHANNEL, Opcode.METADATA_INDEX)
_CANDIDATE = re.compile(rb"[\x01-\x0f](?=.{5}\0{3})", re.DOTALL)  # an opcode, and the length of a record below 1 TB
_CHUNK = re.compile(rb"\x06(?=.{5}\0{3})", re.DOTALL)


def record_end(data: Buffer, at: int, left: int) -> int | None:
    """Return where the record at `at` ends if all its lengths agree; `left`: bytes to the end of the file.

    For records that are found by chance: fields behind those of the specification are not allowed.
    """
    if at + RECORD_HEAD.size > len(data):
        return None
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    body = at + RECORD_HEAD.size
    if opcode not in _OPCODES or RECORD_HEAD.size + length > left:
        return None
    return body + length if _body_length(opcode, data, body, length) == length else None


def stands_outside_chunks(data: Buffer, at: int, left: int) -> bool:
    """Return whether a record of a kind that is never inside a chunk begins here."""
    inside = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
    return record_end(data, at, left) is not None and data[at] not in inside


def fault(data: Buffer, at: int, left: int) -> str | None:
    """Return what is wrong with the record that should begin here; None: it can be read.

    `left`: bytes from `at` to the end of the file. A record of an unknown kind must be followed by one of a known or
    private kind; and unless it is of a private kind itself, no chunk may begin near its head.
    """
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    is_known = opcode in _OPCODES
    if opcode == 0 or (not is_known and not _is_unknown_kind(data, at, length, left)):
        is_zero = not any(data[at : at + RECORD_HEAD.size])
        return "zeros where a record should begin" if is_zero else "no record where one should begin"
    if not is_known or opcode == Opcode.MESSAGE or is_unfinished_chunk(data, at):
        return None
    needed = _body_length(opcode, data, at + RECORD_HEAD.size, length)
    # Later versions may add fields to a record, but not to a chunk, which ends in length-prefixed data.
    if needed is None or needed > length or (opcode == Opcode.CHUNK and needed != length):
        return "a record whose lengths contradict each other"
    needed_bytes = RECORD_HEAD.size + needed
    if needed < length and record_end(data, at + needed_bytes, left - needed_bytes) is not None:
        return "a record whose length includes the next record"
    return None


def is_unfinished_chunk(data: Buffer, at: int) -> bool:
    """Return whether a chunk begins here whose lengths were never filled in.

    Only its data's length, or also that of the record: the recorder writes both once the chunk is complete.
    """
    if at + RECORD_HEAD.size + CHUNK_FIXED.size > len(data):
        return False
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    fixed_at = at + RECORD_HEAD.size
    _first, _last, uncompressed, _crc, name_length = CHUNK_FIXED.unpack_from(data, fixed_at)
    stored_at = fixed_at + CHUNK_FIXED.size + name_length
    if opcode != Opcode.CHUNK or name_length > _LONGEST_COMPRESSION or stored_at + _U64.size > len(data):
        return False
    (stored,) = _U64.unpack_from(data, stored_at)
    return records.PLACEHOLDER in (length, uncompressed, stored)


def has_flipped_opcode(data: Buffer, at: int, left: int, *, behind_chunk: bool) -> bool:
    """Return whether a message record has the lengths of a record whose opcode differs by one bit.

    `left`: bytes from `at` to the end of the file. `behind_chunk`: or behind damage, where message indexes may be; a
    message elsewhere may look like one by chance.
    """
    if left < RECORD_HEAD.size:
        return False
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    if opcode != Opcode.MESSAGE or length > left - RECORD_HEAD.size:
        return False
    kinds = (*_ONE_BIT_AWAY, Opcode.MESSAGE_INDEX) if behind_chunk else _ONE_BIT_AWAY
    return any(_body_length(kind, data, at + RECORD_HEAD.size, length) == length for kind in kinds)


def fault_in_window(data: Buffer, at: int, left: int) -> str | None:
    """Return why no record can begin here; None: one can, or the bytes are not in the window."""
    if at + min(LOOK, left) > len(data) or left < RECORD_HEAD.size:
        return None
    opcode, length = RECORD_HEAD.unpack_from(data, at)
    if length > left - RECORD_HEAD.size and opcode != Opcode.CHUNK:
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
    # A message index follows a chunk: what is before it is one whose beginning is lost.
    return is_private or (opcode != Opcode.MESSAGE_INDEX and record_end(data, after, left) is not None)


def find_record(data: Buffer, start: int, end: int, left: int, channels: Container[int]) -> int | None:
    """Return the first offset in [start, end) where a record begins; `left`: bytes from `start` to the end of the file.

    The lengths in a record verify it. Those of a message are too few: another record must follow, and several if it is
    of none of the `channels`.
    """
    for match in _CANDIDATE.finditer(data, start, end):
        at = match.start()
        after = record_end(data, at, left - (at - start))
        if after is None:
            continue
        if data[at] != Opcode.MESSAGE:
            return at
        (channel_id,) = _U16.unpack_from(data, at + RECORD_HEAD.size)
        needed = _FOLLOWERS if channel_id in channels else _FOLLOWERS_OF_UNKNOWN_CHANNEL
        for _ in range(needed):
            if after is not None and left - (after - start) > 0:
                after = record_end(data, after, left - (after - start))
        if after is not None:
            return at
    return None


def holds_chunk(data: Buffer, start: int, end: int, left: int) -> bool:
    """Return whether a chunk begins in [start, end); `left`: bytes from `start` to the end of the file."""
    offsets = (match.start() for match in _CHUNK.finditer(data, start, end))
    return any(record_end(data, at, left - (at - start)) is not None for at in offsets)


class _LengthPrefixed(NamedTuple):
    """A length-prefixed field. `unit`: the size of its entries; `most`: the largest credible length."""

    length: struct.Struct
    unit: int = 1
    most: int = 2**64


_STRING = _LengthPrefixed(_U32)
_LAYOUTS: dict[int, tuple[int | _LengthPrefixed, ...]] = {
    Opcode.HEADER: (_STRING, _STRING),
    Opcode.SCHEMA: (2, _STRING, _STRING, _STRING),
    Opcode.CHANNEL: (4, _STRING, _STRING, _STRING),
    Opcode.CHUNK: (28, _LengthPrefixed(_U32, most=MAX_NAME), _LengthPrefixed(_U64)),
    Opcode.MESSAGE_INDEX: (2, _LengthPrefixed(_U32, unit=16)),
    Opcode.CHUNK_INDEX: (32, _STRING, 8, _STRING, 16),
    Opcode.ATTACHMENT: (16, _STRING, _STRING, _LengthPrefixed(_U64), 4),
    Opcode.ATTACHMENT_INDEX: (40, _STRING, _STRING),
    Opcode.STATISTICS: (records.STATISTICS_BODY.size, _LengthPrefixed(_U32, unit=10)),
    Opcode.METADATA: (_STRING, _STRING),
    Opcode.METADATA_INDEX: (16, _STRING),
    Opcode.SUMMARY_OFFSET: (17,),
    Opcode.DATA_END: (4,),
}
"""Fields of each record: fixed bytes, or bytes that follow their length."""

_OPCODES = frozenset((*_LAYOUTS, Opcode.FOOTER, Opcode.MESSAGE))


def _body_length(opcode: int, data: Buffer, body: int, length: int) -> int | None:
    """Return the length of a record body by the lengths inside it; None: they are invalid."""
    if opcode == Opcode.MESSAGE:
        return max(length, _MESSAGE_BYTES)
    if opcode == Opcode.FOOTER:
        end = body + records.FOOTER_BODY.size
        return records.FOOTER_BODY.size if data[end : end + len(records.MAGIC)] == records.MAGIC else None
    at = body
    try:
        for part in _LAYOUTS[opcode]:
            if isinstance(part, int):
                at += part
                continue
            size = int(part.length.unpack_from(data, at)[0])
            if size % part.unit or size > part.most:
                return None
            at += part.length.size + size
    except struct.error:
        return None
    return at - body


_END = rb"\x02\x14\0{7}.{20}" + re.escape(MAGIC)  # A footer, and the magic behind it
_MARK = re.compile(_END + b"|" + re.escape(MAGIC), re.DOTALL)


def skip_damage(stream: LookaheadStream, channels: Container[int], losses: DamageReport) -> None:
    """Skip at least one byte, up to the next record of this file."""
    start = 0 if stream.window[stream.at] == Opcode.HEADER and stream.position != len(MAGIC) else 1
    while stream.left:
        width = search_width(stream)
        at, end = stream.at, stream.at + width
        record_at = find_record(stream.window, at + start, end, stream.left - start, channels)
        inner = find_inner(stream.window, at, end if record_at is None else record_at, stream.left)
        if inner is None and record_at is not None and stream.window[record_at] == Opcode.HEADER:
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
    """Return the first offset in [start, end) where another MCAP begins; `left`: bytes from `start` to the end."""
    for match in _MARK.finditer(data, start, min(len(data), end + FOOTER_BYTES)):
        if match.start() >= end:
            return None
        if match[0] == MAGIC and match.end() - start < left:
            return match.start()
    return None


def _pass_inner(stream: LookaheadStream, losses: DamageReport) -> None:
    """Skip another MCAP, which begins here, and those inside it."""
    message = "another MCAP begins inside of this one; its records are not counted"
    losses.note(Malformed(f"byte {stream.position}", message))
    depth = 1
    stream.advance(1)
    while stream.left and depth:
        width = search_width(stream)
        end = min(len(stream.window), stream.at + width + FOOTER_BYTES)
        match = _MARK.search(stream.window, stream.at, end)
        if match is None or match.start() >= stream.at + width:
            stream.advance(width)
            continue
        depth += 1 if match[0] == MAGIC else -1
        stream.advance(match.end() - stream.at)
