"""The messages of an MCAP one after the other, as fast as Python goes: most of the time of a scan passes here."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable
from itertools import repeat
from operator import eq

from kleinkram.recordings.decompress import Buffer
from kleinkram.recordings.mcap.records import MESSAGE, RECORD_HEAD
from kleinkram.recordings.tally import Batch

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
MESSAGE_FIXED = MESSAGE_HEAD.size - RECORD_HEAD.size


_INDEXED_HEAD = struct.Struct("<B8xH4xQ")


def points_at_messages(content: bytes, channel_id: int, stamps: Iterable[int], offsets: array[int]) -> bool:
    """Say whether a message of a channel with each of these log times stands at each of these places of a chunk."""
    if offsets and max(offsets) > len(content) - MESSAGE_HEAD.size:
        return False
    found = map(_INDEXED_HEAD.unpack_from, repeat(content), offsets)
    return all(map(eq, found, zip(repeat(MESSAGE), repeat(channel_id), stamps)))  # repeat never ends


def walk_messages(data: Buffer, at: int, end: int, batch: Batch) -> tuple[int, int]:
    """Add messages from `at` on to the batch, up to something else or a message that ends behind `end`.

    Returns:
        Where that stands, and where the last message begins; twice the same without any message.
    """
    unpack, size, fixed = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size, MESSAGE_FIXED
    last_head, start = end - size, at
    while at <= last_head:
        opcode, length, channel_id, _sequence, log_time, publish_time = unpack(data, at)
        after = at + 9 + length
        if opcode != MESSAGE or after > end or length < fixed:
            break
        batch[channel_id].extend((log_time, publish_time, after - at))
        start, at = at, after
    return at, start
