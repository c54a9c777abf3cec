"""Decompressing a chunk at one stroke: much faster than in steps, for chunks that are small by their own claim."""

from __future__ import annotations

import bz2
import threading

import lz4.frame
import zstandard

from kleinkram.recordings.decompress import ReadUpTo, open_decompressed
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_ZSTD_WINDOW, WINDOW
from kleinkram.recordings.stream import ForwardStream

MAX_CHUNK_HELD = 16 * 2**20
"""Bytes of a chunk, decompressed, that are held in memory; a larger one is spooled to a temporary file."""

Buffer = bytes | memoryview
_of_thread = threading.local()


def unpack(compression: str, stored: Buffer, uncompressed_bytes: int) -> Buffer:
    """Return the content of a chunk that claims at most `MAX_CHUNK_HELD` bytes; "" and "none": it is not compressed.

    Raises:
        Malformed: the data are damaged, or are not as many as is claimed.
    """
    if uncompressed_bytes > MAX_CHUNK_HELD:
        raise Malformed("chunk", f"{uncompressed_bytes} bytes are claimed", certain=False)
    if compression in ("", "none"):
        content = stored
    elif compression == "zstd":
        content = _unpack_zstd(stored, uncompressed_bytes)
    elif compression == "lz4":
        content = _unpack_lz4(stored, uncompressed_bytes)
    elif compression == "bz2":
        content = _unpack_bz2(stored, uncompressed_bytes)
    else:
        raise Malformed("chunk", f"compression '{compression}' is not one that we read", certain=False)
    if len(content) != uncompressed_bytes:
        raise Malformed("chunk", f"{uncompressed_bytes} bytes are claimed, {len(content)} or more came out")
    return content


def limited(stream: ForwardStream, length: int) -> ReadUpTo:
    """Return a function that reads up to n of the next `length` bytes of a stream; empty behind them."""
    left = length

    def read(most: int) -> bytes:
        nonlocal left
        piece = stream.take_some(min(most, left)) if left else b""
        left -= len(piece)
        return piece

    return read


def unpack_message(stored: bytes, most_bytes: int) -> bytes:
    """Return the content of a message that rosbag2 compressed by itself (zstd).

    Raises:
        Malformed: it is damaged, or holds more than `most_bytes`.
    """
    try:
        claimed = zstandard.get_frame_parameters(stored).content_size
        if claimed in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR):
            raise Malformed("message", "its zstd frame does not say how large it is", certain=False)
        if claimed > most_bytes:
            raise Malformed("message", f"{claimed} bytes are claimed; at most {most_bytes} are read", certain=False)
        return _decompressor().decompress(stored)
    except zstandard.ZstdError as error:
        raise Malformed("message", f"its zstd data is damaged ({error})") from error


def _decompressor() -> zstandard.ZstdDecompressor:
    known: zstandard.ZstdDecompressor | None = getattr(_of_thread, "decompressor", None)
    if known is None:
        known = _of_thread.decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_ZSTD_WINDOW)
    return known


def _unpack_zstd(stored: Buffer, uncompressed_bytes: int) -> bytes:
    try:
        parameters = zstandard.get_frame_parameters(stored)
        if parameters.content_size == uncompressed_bytes and parameters.window_size <= MAX_ZSTD_WINDOW:
            return _decompressor().decompress(stored)
    except zstandard.ZstdError as error:
        raise Malformed("chunk", f"its zstd data is damaged ({error})") from error
    # Several frames, or one that does not say its size: in steps, so that nothing is believed.
    view, at = memoryview(stored), 0

    def read(most: int) -> bytes:
        nonlocal at
        piece = bytes(view[at : at + most])
        at += len(piece)
        return piece

    stream = open_decompressed("zstd", read, uncompressed_bytes)
    pieces: list[bytes] = []
    while not stream.at_end():
        pieces.append(stream.take(min(WINDOW, uncompressed_bytes - stream.position)))
    return b"".join(pieces)


def _unpack_lz4(stored: Buffer, uncompressed_bytes: int) -> bytes:
    try:
        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=uncompressed_bytes + 1)
    except RuntimeError as error:
        raise Malformed("chunk", f"its lz4 data is damaged ({error})") from error
    return content


def _unpack_bz2(stored: Buffer, uncompressed_bytes: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(stored, max_length=uncompressed_bytes + 1)
    except (OSError, ValueError) as error:
        raise Malformed("chunk", f"its bz2 data is damaged ({error})") from error
