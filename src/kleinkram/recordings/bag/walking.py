"""The messages of a bag one after the other, as fast as Python goes: most of the time of a scan passes here.

The header of a message has always the same fields and the same length, only their order is the writer's. So the
layout is taken from the first message, and every other header is compared with it as a whole.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from operator import itemgetter

from kleinkram.recordings.decompress import Buffer
from kleinkram.recordings.tally import Batch

_FIELDS = {b"op": "8s", b"conn": "9sI", b"time": "9sII"}
_VALUES = {b"op": 1, b"conn": 2, b"time": 3}
_HEADER_BYTES = 38
_U32 = struct.Struct("<I")


class MessageLayout:
    """Where the fields of a message's header stand, learned from one of them."""

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
    """Return the layout of the message record at `at`; None if it is no usual one."""
    if _U32.unpack_from(data, at)[0] != _HEADER_BYTES:
        return None
    order, place, end = [], at + _U32.size, at + _U32.size + _HEADER_BYTES
    while place < end:
        length = int(_U32.unpack_from(data, place)[0])
        order.append(bytes(data[place + _U32.size : place + _U32.size + length]).partition(b"=")[0])
        place += _U32.size + length
    return MessageLayout(tuple(order), data, at) if sorted(order) == sorted(_FIELDS) else None


def walk_messages(data: Buffer, at: int, end: int, layout: MessageLayout, batch: Batch) -> tuple[int, int]:
    """Add messages from `at` on to the batch, up to something else or a message that ends behind `end`.

    Returns:
        Where that stands, and where the last message begins; twice the same without any message.
    """
    unpack, size = layout.layout.unpack_from, layout.layout.size
    constants, expected, values = layout.constants, layout.expected, layout.values
    last_head, start = end - size, at
    while at <= last_head:
        found = unpack(data, at)
        if constants(found) != expected:
            break
        connection, seconds, nanoseconds, length = values(found)
        after = at + size + length
        if after > end:
            break
        batch[connection].extend((seconds * 1_000_000_000 + nanoseconds, 0, after - at))
        start, at = at, after
    return at, start
