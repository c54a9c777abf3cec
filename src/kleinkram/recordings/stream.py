"""Forward reading of a range or of a decompressor, in windows, with an optional running CRC-32.

Holds one window, plus what `take` was asked for. Never trusts a length further than the end that it was given.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_TAKE, WINDOW
from kleinkram.recordings.sources import Source

Refill = Callable[[], bytes]


class Cut(Malformed):
    """The bytes end before the thing that is being read does."""


class ForwardStream:
    """Bytes in order: take some, skip some.

    Attributes:
        position: of the next byte, counted from `start`.
    """

    def __init__(self, refill: Refill, *, start: int = 0, jump: Callable[[int], None] | None = None) -> None:
        self._refill = refill
        self._jump = jump
        self._window = b""
        self._at = 0
        self.position = start
        self._crcs: list[int] = []

    @property
    def crc(self) -> int:
        """CRC-32 of all that was taken or skipped since the latest `start_crc`; 0 if none runs."""
        return self._crcs[-1] if self._crcs else 0

    def start_crc(self) -> None:
        """Keep a CRC-32 from here on, beside those that run already."""
        self._crcs.append(0)

    def stop_crc(self) -> int:
        """End the CRC that was started last, and return it. Without any, `skip` jumps."""
        return self._crcs.pop()

    def take(self, length: int) -> bytes:
        """Return the next `length` bytes.

        Raises:
            Cut: there are fewer.
            Malformed: more than `MAX_TAKE`.
        """
        if length > MAX_TAKE:
            raise Malformed(
                f"byte {self.position}", f"{length} bytes are claimed; at most {MAX_TAKE} are read", certain=False
            )
        end = self._at + length
        if end > len(self._window):
            self._need(length)
            end = length
        data = self._window[self._at : end]
        self._move(length, data)
        return data

    def skip(self, length: int) -> None:
        """Pass over the next `length` bytes; jumps where it can.

        Raises:
            Cut: there are fewer.
            Malformed: `length` is negative: a record claims to end before the fields that it must have.
        """
        if length < 0:
            raise Malformed(f"byte {self.position}", "a record that is too short for its fields")
        while length:
            at_hand = min(length, len(self._window) - self._at)
            if at_hand:
                self._move(at_hand, self._window[self._at : self._at + at_hand] if self._crcs else b"")
                length -= at_hand
            elif self._jump is not None and not self._crcs:
                self._jump(length)
                self.position += length
                return
            else:
                self._window = self._refill()
                self._at = 0
                if not self._window:
                    raise Cut(f"byte {self.position}", f"{length} more bytes are claimed than there are")

    def at_end(self) -> bool:
        """Say whether nothing is left."""
        if self._at == len(self._window):
            self._window = self._refill()
            self._at = 0
        return not self._window

    def _need(self, length: int) -> None:
        """Bring at least `length` bytes to the front of the window."""
        pieces = [self._window[self._at :]]
        have = len(pieces[0])
        while have < length:
            piece = self._refill()
            if not piece:
                self._window, self._at = b"".join(pieces), 0
                raise Cut(f"byte {self.position}", f"{length} bytes are claimed, {have} are there")
            pieces.append(piece)
            have += len(piece)
        self._window = b"".join(pieces)
        self._at = 0

    def _move(self, length: int, data: bytes) -> None:
        for number, crc in enumerate(self._crcs):
            self._crcs[number] = zlib.crc32(data, crc)
        self._at += length
        self.position += length


def open_range(source: Source, start: int, end: int, *, window: int = WINDOW) -> ForwardStream:
    """Read [start, end) of a source forward. `end` is cut to the size of the source."""
    end = min(end, source.size_bytes)
    offset = start

    def refill() -> bytes:
        nonlocal offset
        length = min(window, end - offset)
        if length <= 0:
            return b""
        data = source.read(offset, length)
        offset += length
        return data

    def jump(length: int) -> None:
        nonlocal offset
        if length > end - offset:
            raise Cut(f"byte {offset}", f"{length} bytes are claimed, {max(0, end - offset)} are there")
        offset += length

    return ForwardStream(refill, start=start, jump=jump)


def open_bytes(data: bytes, start: int) -> ForwardStream:
    """Read bytes that are at hand; `start` is their place in the file."""
    pieces = [data]
    return ForwardStream(lambda: pieces.pop() if pieces else b"", start=start)
