"""Buffered sequential reading, with an optional running CRC-32.

Holds one window, and what `take` returns; no length is trusted beyond the end of the range. `LookaheadStream` is for
scans: it shows the next bytes before it skips them.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

from kleinkram.recordings.errors import Cut, Malformed, SourceError
from kleinkram.recordings.limits import MAX_CHUNK_BYTES, MAX_TAKE, WINDOW
from kleinkram.recordings.sources import SequentialReader, Source, raise_malloc_threshold

_STEP = 256 * 2**10
_FIRST_BUFFER = 2 * 2**20

Refill = Callable[[], bytes]


class ByteStream:
    """Reads or skips bytes in order. `position`: of the next byte, counted from `start`."""

    def __init__(self, refill: Refill, *, start: int = 0, jump: Callable[[int], None] | None = None) -> None:
        self._refill = refill
        self._jump = jump
        self._window = b""
        self._at = 0
        self.position = start
        self._crc: int | None = None

    @property
    def crc(self) -> int:
        """CRC-32 of what was read or skipped since `start_crc`; 0 if none runs."""
        return self._crc or 0

    def start_crc(self) -> None:
        """Start a CRC-32."""
        self._crc = 0

    def take(self, length: int) -> bytes:
        """Return the next `length` bytes."""
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

    def take_some(self, max_bytes: int = MAX_TAKE) -> bytes:
        """Return at least one and at most `max_bytes` of the next bytes; b"" at the end."""
        if self.at_end():
            return b""
        return self.take(min(max_bytes, len(self._window) - self._at))

    def skip(self, length: int) -> None:
        """Skip the next `length` bytes, by a seek where possible."""
        if length < 0:
            raise Malformed(f"byte {self.position}", "a record that is too short for its fields")
        while length:
            at_hand = min(length, len(self._window) - self._at)
            if at_hand:
                self._move(at_hand, b"" if self._crc is None else self._window[self._at : self._at + at_hand])
                length -= at_hand
            elif self._jump is not None and self._crc is None:
                self._jump(length)
                self.position += length
                return
            else:
                self._window = self._refill()
                self._at = 0
                if not self._window:
                    raise Cut(f"byte {self.position}", f"{length} more bytes are claimed than there are")

    def at_end(self) -> bool:
        """Return whether no bytes remain."""
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
        if self._crc is not None:
            self._crc = zlib.crc32(data, self._crc)
        self._at += length
        self.position += length


def open_range(source: Source, start: int, end: int, *, window: int = WINDOW) -> ByteStream:
    """Read [start, end) of a source; `end` is limited to its size."""
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

    return ByteStream(refill, start=start, jump=jump)


def open_bytes(data: bytes, start: int) -> ByteStream:
    """Read bytes in memory; `start`: their offset in the file."""
    pieces = [data]
    return ByteStream(lambda: pieces.pop() if pieces else b"", start=start)


class LookaheadStream:
    """Looks at the next bytes of a file before it skips them; keeps a CRC-32 of skipped bytes on request.

    The next byte is at `at` of `window`. The buffer is reused, because data in the processor's cache is read about
    twice as fast.
    """

    def __init__(self, reader: SequentialReader, *, with_crc: bool = True) -> None:
        self._reader = reader
        self._with_crc = with_crc
        self.size_bytes = reader.size_bytes
        raise_malloc_threshold()
        self._buffer = memoryview(bytearray(_FIRST_BUFFER))
        self.window = self._buffer[:0]
        self.at = 0
        self._window_start = 0
        self._crc = 0
        self._hashed = 0

    @property
    def position(self) -> int:
        """Of the next byte in the file."""
        return self._window_start + self.at

    @property
    def left(self) -> int:
        """Bytes from here to the end of the file."""
        return self.size_bytes - self._window_start - self.at

    def ahead(self, length: int) -> int:
        """Bring up to `length` of the next bytes into the window, `MAX_CHUNK_BYTES` at most; return how many there are.

        This overwrites the window: slices of the previous window are invalid afterwards.
        """
        length = min(length, MAX_CHUNK_BYTES + WINDOW, self.left)
        if len(self.window) - self.at < length:
            self._refill(length)
        return length

    def advance(self, length: int) -> None:
        """Skip the next `length` bytes, which must be there."""
        while length > len(self.window) - self.at:
            length -= len(self.window) - self.at
            self.at = len(self.window)
            self.ahead(min(length, _STEP))
        self.at += length

    def digest(self, length: int) -> int:
        """Skip the next `length` bytes, and return their CRC-32."""
        crc = 0
        while length:
            step = min(length, _STEP)
            self.ahead(step)
            crc = zlib.crc32(self.window[self.at : self.at + step], crc)
            self.at += step
            length -= step
        return crc

    def read_up_to(self, length: int) -> bytes:
        """Return up to `length` of the next bytes; b"" at the end of the file."""
        length = self.ahead(length)
        self.at += length
        return bytes(self.window[self.at - length : self.at])

    def crc(self) -> int:
        """Return the CRC-32 of what was skipped since the beginning, or since `restart_crc`."""
        self._crc = zlib.crc32(self.window[self._hashed : self.at], self._crc)
        self._hashed = self.at
        return self._crc

    def restart_crc(self) -> None:
        """Restart the CRC-32."""
        self._crc, self._hashed = 0, self.at

    def _refill(self, need: int) -> None:
        if self._with_crc:
            self.crc()
        rest = self.window[self.at :]
        have = len(rest)
        if need + _STEP > len(self._buffer):
            self._buffer = memoryview(bytearray(need + _STEP))
        self._buffer[:have] = rest
        try:
            while have < need:
                piece = self._reader.read(_STEP)
                if not piece:
                    raise SourceError(f"{self._reader.name}: ended before its {self.size_bytes} bytes")
                self._buffer[have : have + len(piece)] = piece
                have += len(piece)
        finally:  # what came before an error is in memory
            self._window_start += self.at
            self.window = self._buffer[:have]
            self.at = self._hashed = 0
