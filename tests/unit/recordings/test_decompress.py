"""Complete compressed chunks: the data ends with the chunk and has the claimed size."""

from __future__ import annotations

import bz2
from collections.abc import Callable

import lz4.frame
import pytest
import zstandard

from kleinkram.recordings.compression import decompress
from kleinkram.recordings.errors import Malformed

RAW = bytes(range(256)) * 40


def zstd_of_unknown_size(raw: bytes) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=False).compress(raw)


PACKINGS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "lz4": ("lz4", lz4.frame.compress),
    "bz2": ("bz2", bz2.compress),
    "zstd": ("zstd", zstandard.compress),
    "zstd of unknown size": ("zstd", zstd_of_unknown_size),
    "none": ("none", bytes),
}


@pytest.mark.parametrize("packing", PACKINGS)
def test_complete_data(packing: str) -> None:
    name, pack = PACKINGS[packing]
    assert decompress(name, memoryview(pack(RAW)), len(RAW)) == RAW


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
EMPTY_FRAME = zstandard.compress(b"")
SKIPPABLE = b"\x50\x2a\x4d\x18" + (5).to_bytes(4, "little") + b"hello"
LEFT_OVER = {
    "a zero": bytes(1),
    "zeros": bytes(500),
    "words": b"rubbish",
    "a bare magic": ZSTD_MAGIC,
    "the beginning of an empty frame": EMPTY_FRAME[:-1],
    "the beginning of a frame to skip": SKIPPABLE[:-1],
}


@pytest.mark.parametrize("left_over", LEFT_OVER.values(), ids=LEFT_OVER)
@pytest.mark.parametrize("packing", PACKINGS)
def test_bytes_left_over_are_refused(packing: str, left_over: bytes) -> None:
    name, pack = PACKINGS[packing]
    with pytest.raises(Malformed):
        decompress(name, memoryview(pack(RAW) + left_over), len(RAW))


@pytest.mark.parametrize("packing", PACKINGS)
def test_data_that_break_off_are_refused(packing: str) -> None:
    name, pack = PACKINGS[packing]
    with pytest.raises(Malformed):
        decompress(name, memoryview(pack(RAW)[:-20]), len(RAW))


@pytest.mark.parametrize("packing", PACKINGS)
def test_data_after_the_compressed_stream_are_refused(packing: str) -> None:
    name, pack = PACKINGS[packing]
    with pytest.raises(Malformed):
        decompress(name, memoryview(2 * pack(RAW)), len(RAW))


@pytest.mark.parametrize("following", [EMPTY_FRAME, SKIPPABLE, EMPTY_FRAME + SKIPPABLE])
@pytest.mark.parametrize("packing", ["zstd", "zstd of unknown size"])
def test_complete_frames_without_content_may_follow(packing: str, following: bytes) -> None:
    """zstd data are one or more frames (RFC 8878, section 3.1)."""
    name, pack = PACKINGS[packing]
    assert decompress(name, memoryview(pack(RAW) + following), len(RAW)) == RAW
