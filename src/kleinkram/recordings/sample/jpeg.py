"""Baseline JPEGs of mosaics: one grey tile an 8x8 block. Small, quick to make, and readable by any decoder.

Source: ITU-T T.81. With only the DC coefficient of each block there is no cosine transform to compute.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

_BLOCK = 8
# Annex K.3, luminance DC: how many codes of each length, and the categories in their order.
_DC_LENGTHS = bytes([0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0])
_DC_CATEGORIES = bytes(range(12))
# The only AC code is "end of block".
_AC_LENGTHS = bytes([1] + [0] * 15)
_AC_SYMBOLS = b"\x00"
_MOST_IN_SEGMENT = 65533
_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"


def mosaic_jpeg(tiles: Sequence[Sequence[int]]) -> bytes:
    """Return a grey JPEG of 8x8 tiles; `tiles`: rows of brightness, 0 (black) to 255."""
    rows, columns = len(tiles), len(tiles[0])
    frame = struct.pack(">BHHBBBB", 8, rows * _BLOCK, columns * _BLOCK, 1, 1, 0x11, 0)
    return b"".join(
        (
            _SOI,
            _segment(0xDB, b"\x00" + bytes([_BLOCK] * 64)),
            _segment(0xC0, frame),
            _segment(0xC4, b"\x00" + _DC_LENGTHS + _DC_CATEGORIES),
            _segment(0xC4, b"\x10" + _AC_LENGTHS + _AC_SYMBOLS),
            _segment(0xDA, bytes([1, 1, 0x00, 0, 63, 0])),
            _scan(tiles),
            _EOI,
        )
    )


def padded(jpeg: bytes, noise: bytes) -> bytes:
    """Return the same picture with `noise` in comment segments, so that it has the size of a real camera's."""
    comments = [_segment(0xFE, noise[at : at + _MOST_IN_SEGMENT]) for at in range(0, len(noise), _MOST_IN_SEGMENT)]
    return b"".join((_SOI, *comments, jpeg[len(_SOI) :]))


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def _scan(tiles: Sequence[Sequence[int]]) -> bytes:
    codes = _dc_codes()
    bits: list[str] = []
    before = 0
    for row in tiles:
        for brightness in row:
            # The DC coefficient is 8 times the mean above 128; quantised by 8, it is that mean itself.
            level = brightness - 128
            bits.append(_dc_bits(level - before, codes) + "0")
            before = level
    text = "".join(bits)
    text += "1" * (-len(text) % 8)
    return int(text, 2).to_bytes(len(text) // 8, "big").replace(b"\xff", b"\xff\x00")


def _dc_bits(difference: int, codes: list[str]) -> str:
    category = abs(difference).bit_length()
    if category == 0:
        return codes[0]
    value = difference if difference > 0 else difference + (1 << category) - 1
    return codes[category] + format(value, f"0{category}b")


def _dc_codes() -> list[str]:
    codes: list[str] = []
    code = 0
    for length, count in enumerate(_DC_LENGTHS, start=1):
        for _ in range(count):
            codes.append(format(code, f"0{length}b"))
            code += 1
        code <<= 1
    return codes
