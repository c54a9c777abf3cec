"""What is compressed inside of files that are read: the stored bytes of a chunk, and single messages."""

from __future__ import annotations

import threading

import zstandard

from kleinkram.recordings.decompress import ReadUpTo
from kleinkram.recordings.errors import Malformed
from kleinkram.recordings.limits import MAX_ZSTD_WINDOW
from kleinkram.recordings.stream import ForwardStream

_of_thread = threading.local()


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
