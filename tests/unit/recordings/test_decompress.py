"""Compressed chunks as a whole: their data end where the chunk ends, and hold what it claims."""

from __future__ import annotations

import bz2
from collections.abc import Callable

import lz4.frame
import pytest
import zstandard

from kleinkram.recordings.decompress import decompress
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
def test_whole_data(packing: str) -> None:
    name, pack = PACKINGS[packing]
    assert decompress(name, memoryview(pack(RAW)), len(RAW)) == RAW


@pytest.mark.parametrize("left_over", [bytes(1), bytes(500), b"rubbish"], ids=["a zero", "zeros", "words"])
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
def test_the_same_once_more_is_refused(packing: str) -> None:
    name, pack = PACKINGS[packing]
    with pytest.raises(Malformed):
        decompress(name, memoryview(2 * pack(RAW)), len(RAW))
