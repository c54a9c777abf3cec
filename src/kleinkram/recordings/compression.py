"""Decompresses chunks and messages (zstd, lz4, bz2), up to the size that the file states."""

from __future__ import annotations

import bz2
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Protocol

import lz4.frame
import zstandard

from kleinkram.recordings.errors import Cut, Malformed
from kleinkram.recordings.limits import MAX_CHUNK_BYTES, MAX_ZSTD_WINDOW, WINDOW
from kleinkram.recordings.streams import ByteStream, Refill

_MIN_ZEROS = 64
Buffer = bytes | memoryview
ReadUpTo = Callable[[int], bytes]


def is_known_compression(name: str) -> bool:
    """Return whether chunks with this compression can be read; `name` as in MCAP or a bag."""
    return name in ("", "none", "zstd", "lz4", "bz2")


def unknown_compression(name: str) -> Malformed:
    """Return why a chunk with an unknown compression is not read."""
    return Malformed("chunk", f"unknown compression '{name}'", certain=False)


def unreadable_chunk(name: str, *, stored: int, uncompressed: int) -> Malformed | None:
    """Return why a chunk cannot be read, by its compression and sizes; None: it can."""
    if not is_known_compression(name):
        return unknown_compression(name)
    size = max(stored, uncompressed)
    if size > MAX_CHUNK_BYTES:
        return Malformed("chunk", f"it has {size} bytes; chunks above {MAX_CHUNK_BYTES} are not read", certain=False)
    return None


def open_decompressed(name: str, read: ReadUpTo, uncompressed_bytes: int) -> ByteStream:
    """Decompress what `read` returns; `name` as in MCAP or a bag."""
    refill: Refill
    if name in ("", "none"):
        refill = partial(read, WINDOW)
    elif name == "bz2":
        refill = _in_windows(name, read, bz2.BZ2Decompressor(), OSError)
    elif name == "zstd":
        refill = _zstd(read)
    elif name == "lz4":
        refill = _in_windows(name, read, lz4.frame.LZ4FrameDecompressor(), RuntimeError)
    else:
        raise unknown_compression(name)
    total = 0

    def refill_bounded() -> bytes:
        nonlocal total
        piece = refill()
        total += len(piece)
        if total > uncompressed_bytes:
            raise Malformed("chunk", f"more than the {uncompressed_bytes} bytes that it claims to hold")
        return piece

    return ByteStream(refill_bounded)


def decompress(name: str, stored: Buffer, uncompressed_bytes: int) -> bytes:
    """Decompress a whole chunk; `name` as in MCAP or a bag."""
    if name in ("", "none"):
        raw = bytes(stored)
    elif name == "zstd":
        raw = _decompress_zstd(stored, uncompressed_bytes)
    elif name == "lz4":
        raw = _decompress_lz4(stored, uncompressed_bytes)
    else:
        raw = _decompress_stream(name, stored, uncompressed_bytes)
    if len(raw) != uncompressed_bytes:
        raise Malformed("chunk", f"{uncompressed_bytes} bytes are claimed, {len(raw)} came out")
    return raw


def decompress_beginning(name: str, stored: bytes, uncompressed_bytes: int) -> bytes:
    """Decompress a chunk whose end is missing, as far as possible, up to `uncompressed_bytes`."""
    if name in ("", "none"):
        return stored[:uncompressed_bytes]
    pieces: list[bytes] = []
    with suppress(Malformed):
        stream = open_decompressed(name, _read_once(stored), uncompressed_bytes)
        pieces.extend(iter(stream.take_some, b""))
    return b"".join(pieces)


def without_zero_tail(name: str, stored: bytes) -> bytes | None:
    """Return compressed data without trailing zeros; None if there are too few for lost sectors of a disk."""
    without_zeros = stored.rstrip(b"\0")
    return without_zeros if name not in ("", "none") and len(stored) - len(without_zeros) >= _MIN_ZEROS else None


def _decompress_zstd(stored: Buffer, uncompressed_bytes: int) -> bytes:
    try:
        claimed = zstandard.frame_content_size(stored)
        if claimed == uncompressed_bytes:
            return zstandard.ZstdDecompressor().decompress(stored, allow_extra_data=False)
    except zstandard.ZstdError:
        pass  # the stream below raises, unless only a frame without content follows
    # Of unknown size, or of several frames.
    return _decompress_stream("zstd", stored, uncompressed_bytes)


def _decompress_stream(name: str, stored: Buffer, uncompressed_bytes: int) -> bytes:
    stream = open_decompressed(name, _read_once(bytes(stored)), uncompressed_bytes)
    return b"".join(iter(stream.take_some, b""))


def _read_once(data: bytes) -> ReadUpTo:
    pieces = [data]
    return lambda _: pieces.pop() if pieces else b""


def _decompress_lz4(stored: Buffer, uncompressed_bytes: int) -> bytes:
    context = lz4.frame.create_decompression_context()
    try:
        # One byte more than claimed, so that the end mark and its checksum are read, too. By way of a context, because
        # LZ4FrameDecompressor copies what it is given.
        raw, used, is_complete = lz4.frame.decompress_chunk(context, stored, max_length=uncompressed_bytes + 1)
    except (RuntimeError, EOFError) as error:
        raise Malformed("chunk", f"its lz4 data is damaged ({error})") from error
    if not is_complete or used != len(stored):
        raise Malformed("chunk", "its lz4 data do not end where it ends")
    return bytes(raw)


class _ZstdInput:
    """File-like input of zstandard's reader; notes the window size of the first frame."""

    def __init__(self, read: ReadUpTo) -> None:
        self._read = read
        self.window = 0
        self.frames = ZstdFrames()

    def read(self, size: int = WINDOW) -> bytes:
        data = self._read(size)
        self.frames.feed(data)
        if not self.window and data:
            self.window = max(1, zstandard.get_frame_parameters(data).window_size)
            if self.window > MAX_ZSTD_WINDOW:
                raise Malformed("chunk", f"its zstd data needs {self.window} bytes of memory", certain=False)
        return data


def _zstd(read: ReadUpTo) -> Refill:
    decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_ZSTD_WINDOW)
    reading = _ZstdInput(read)
    reader = decompressor.stream_reader(reading, read_across_frames=True)  # type: ignore[arg-type]  # only read() is used

    def refill() -> bytes:
        try:
            piece = reader.read(WINDOW)
        except zstandard.ZstdError as error:
            # zstandard has one error for bad data and for too little memory. The latter is not the file's fault:
            # allocating as much raises a MemoryError then.
            bytearray(reading.window + WINDOW)
            raise Malformed("chunk", f"its zstd data is damaged ({error})") from error
        if not piece and not reading.frames.at_end_of_frame:
            raise Cut("chunk", "its zstd data breaks off")
        return piece

    return refill


class _Decompressor(Protocol):
    """The common interface of the lz4 and bz2 decompressors."""

    @property
    def eof(self) -> bool: ...
    @property
    def needs_input(self) -> bool: ...
    @property
    def unused_data(self) -> bytes | None: ...
    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


def _in_windows(name: str, read: ReadUpTo, decompressor: _Decompressor, damage: type[Exception]) -> Refill:
    """Return a function that decompresses the next window; `damage`: the exception of this library for damaged data."""

    def refill() -> bytes:
        while not decompressor.eof:
            data = read(WINDOW) if decompressor.needs_input else b""
            if decompressor.needs_input and not data:
                raise Malformed("chunk", f"its {name} data breaks off")
            try:
                piece = decompressor.decompress(data, max_length=WINDOW)
            except damage as error:
                raise Malformed("chunk", f"its {name} data is damaged ({error})") from error
            if piece:
                return piece
        if decompressor.unused_data or read(1):
            raise Malformed("chunk", "its data do not end where it ends")
        return b""

    return refill


class ZstdFrames:
    """Tracks zstd frames, to find out whether data ends at the end of a frame, which zstandard does not show."""

    def __init__(self) -> None:
        self._head = b""
        self._head_bytes = 4
        self._skip = 0
        self._step: Callable[[bytes], None] = self._on_magic
        self._checksum_bytes = 0

    @property
    def at_end_of_frame(self) -> bool:
        """Return whether the bytes so far end with a frame."""
        return not self._head and not self._skip and self._step == self._on_magic

    def feed(self, data: bytes) -> None:
        """Follow the next packed bytes."""
        at = 0
        while at < len(data):
            if self._skip:
                skipped = min(self._skip, len(data) - at)
                self._skip -= skipped
                at += skipped
                continue
            piece = data[at : at + self._head_bytes - len(self._head)]
            self._head += piece
            at += len(piece)
            if len(self._head) == self._head_bytes:
                head, self._head = self._head, b""
                self._step(head)

    def _next(self, step: Callable[[bytes], None], head_bytes: int, *, skip: int = 0) -> None:
        self._step, self._head_bytes, self._skip = step, head_bytes, skip

    def _on_magic(self, head: bytes) -> None:
        if head[1:] == b"\x2a\x4d\x18" and head[0] >> 4 == 5:
            self._next(self._on_skippable, 4)
        else:
            self._next(self._on_descriptor, 1)

    def _on_skippable(self, head: bytes) -> None:
        self._next(self._on_magic, 4, skip=int.from_bytes(head, "little"))

    def _on_descriptor(self, head: bytes) -> None:
        size_flag, single_segment = head[0] >> 6, head[0] >> 5 & 1
        self._checksum_bytes = 4 if head[0] & 4 else 0
        size_bytes = (single_segment, 2, 4, 8)[size_flag]
        self._next(self._on_block, 3, skip=(1 - single_segment) + (0, 1, 2, 4)[head[0] & 3] + size_bytes)

    def _on_block(self, head: bytes) -> None:
        block = int.from_bytes(head, "little")
        body = 1 if block >> 1 & 3 == 1 else block >> 3
        if block & 1:
            self._next(self._on_magic, 4, skip=body + self._checksum_bytes)
        else:
            self._next(self._on_block, 3, skip=body)


_of_thread = threading.local()


def unpack_message(stored: bytes, max_bytes: int) -> bytes:
    """Decompress a message that rosbag2 compressed separately (zstd)."""
    try:
        claimed = zstandard.get_frame_parameters(stored).content_size
        if claimed in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR):
            raise Malformed("message", "its zstd frame does not say how large it is", certain=False)
        if claimed > max_bytes:
            raise Malformed("message", f"{claimed} bytes are claimed; at most {max_bytes} are read", certain=False)
        known: zstandard.ZstdDecompressor | None = getattr(_of_thread, "decompressor", None)
        if known is None:
            known = _of_thread.decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_ZSTD_WINDOW)
        return known.decompress(stored)
    except zstandard.ZstdError as error:
        raise Malformed("message", f"its zstd data is damaged ({error})") from error
