"""Compressed chunks as forward streams: bounded output a step, never more than the chunk claims to hold."""

from __future__ import annotations

from collections.abc import Callable

import lz4.frame
import zstandard

from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_ZSTD_WINDOW, WINDOW
from kleinkram.recordings.stream import ForwardStream, Refill

ReadUpTo = Callable[[int], bytes]


def open_decompressed(name: str, read: ReadUpTo, uncompressed_bytes: int) -> ForwardStream:
    """Decompress what `read` returns; `name` as MCAP spells it: "", "lz4" or "zstd".

    Raises:
        Malformed: at once for another name; while reading for bad data, or more bytes than were claimed.
    """
    if name == "":
        return ForwardStream(_bounded(lambda: read(WINDOW), uncompressed_bytes))
    if name == "zstd":
        return ForwardStream(_bounded(_zstd(read), uncompressed_bytes))
    if name == "lz4":
        return ForwardStream(_bounded(_lz4(read), uncompressed_bytes))
    raise Malformed("chunk", f"compression '{name}' is not one that we read", certain=False)


def _bounded(refill: Refill, most: int) -> Refill:
    total = 0

    def refill_bounded() -> bytes:
        nonlocal total
        piece = refill()
        total += len(piece)
        if total > most:
            raise Malformed("chunk", f"more than the {most} bytes that it claims to hold")
        return piece

    return refill_bounded


class _Reading:
    """The little of a file that zstandard's reader asks for; notes the window that the first frame wants."""

    def __init__(self, read: ReadUpTo) -> None:
        self._read = read
        self.window = 0

    def read(self, size: int = WINDOW) -> bytes:
        data = self._read(size)
        if not self.window and data:
            self.window = max(1, zstandard.get_frame_parameters(data).window_size)
            if self.window > MAX_ZSTD_WINDOW:
                raise Malformed("chunk", f"its zstd data want {self.window} bytes of memory to be read", certain=False)
        return data


def _zstd(read: ReadUpTo) -> Refill:
    decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_ZSTD_WINDOW)
    reading = _Reading(read)
    reader = decompressor.stream_reader(reading, read_across_frames=True)  # type: ignore[arg-type]  # only read() is used

    def refill() -> bytes:
        try:
            return reader.read(WINDOW)
        except zstandard.ZstdError as error:
            # zstandard has one error for bad data and for too little memory. The latter is not the file's fault:
            # whether there was enough is tried out, and a MemoryError says that there was not.
            bytearray(reading.window + WINDOW)
            raise Malformed("chunk", f"its zstd data is damaged ({error})") from error

    return refill


def _lz4(read: ReadUpTo) -> Refill:
    decompressor = lz4.frame.LZ4FrameDecompressor()

    def refill() -> bytes:
        while not decompressor.eof:
            data = read(WINDOW) if decompressor.needs_input else b""
            if decompressor.needs_input and not data:
                raise Malformed("chunk", "its lz4 data breaks off")
            try:
                piece: bytes = decompressor.decompress(data, max_length=WINDOW)
            except RuntimeError as error:
                raise Malformed("chunk", f"its lz4 data is damaged ({error})") from error
            if piece:
                return piece
        return b""

    return refill
