"""Encodes grey pictures made of tiles as baseline JPEG: fast without numpy, and every decoder reads them.

Source: ITU-T T.81, annexes B and K.3.
"""

from __future__ import annotations

import struct
from operator import sub

TILE_PIXELS = 8
_MAX_IN_SEGMENT = 65533
_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
# Annex K.3 of ITU-T T.81, luminance DC: how many codes of each length, and the categories in their order.
_DC_LENGTHS = bytes([0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0])
_DC_CATEGORIES = bytes(range(12))
# The only AC code is "end of block".
_AC_LENGTHS = bytes([1] + [0] * 15)
_AC_SYMBOLS = b"\x00"


def mosaic_jpeg(tiles: bytes, columns: int) -> bytes:
    """Return a JPEG of tiles of 8 x 8 pixels, DC coefficients only.

    `tiles`: the brightness of each, 0 to 255, row by row.
    """
    frame = struct.pack(">BHHBBBB", 8, len(tiles) // columns * TILE_PIXELS, columns * TILE_PIXELS, 1, 1, 0x11, 0)
    # The DC coefficient is 8 times the mean above 128; quantised by 8, it is that mean itself. Stored are differences.
    text = "".join(map(_CODES.__getitem__, map(sub, tiles, b"\x80" + tiles[:-1])))
    text += "1" * (-len(text) % 8)
    scan = int(text, 2).to_bytes(len(text) // 8, "big").replace(b"\xff", b"\xff\x00")
    return b"".join((_SOI, _QUANTISATION, _segment(0xC0, frame), _TABLES, scan, _EOI))


def padded(jpeg: bytes, noise: bytes) -> bytes:
    """Return the same picture with `noise` in comment segments, so that it has the size of a real camera's."""
    comments = [_segment(0xFE, noise[at : at + _MAX_IN_SEGMENT]) for at in range(0, len(noise), _MAX_IN_SEGMENT)]
    return b"".join((_SOI, *comments, jpeg[len(_SOI) :]))


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def _codes() -> list[str]:
    """Return the bits of a tile by its difference from the one before, -255 to 255; negative ones count from the end.

    Each is the code of the category, the value, and "end of block".
    """
    categories: list[str] = []
    code = 0
    for length, count in enumerate(_DC_LENGTHS, start=1):
        categories += [format(code + number, f"0{length}b") for number in range(count)]
        code = (code + count) << 1
    codes: list[str] = []
    for difference in [*range(256), *range(-255, 0)]:
        category = abs(difference).bit_length()
        value = difference if difference > 0 else difference + (1 << category) - 1
        codes.append(categories[category] + (format(value, f"0{category}b") if category else "") + "0")
    return codes


_CODES = _codes()
_QUANTISATION = _segment(0xDB, b"\x00" + bytes([TILE_PIXELS] * 64))
_TABLES = b"".join(
    (
        _segment(0xC4, b"\x00" + _DC_LENGTHS + _DC_CATEGORIES),
        _segment(0xC4, b"\x10" + _AC_LENGTHS + _AC_SYMBOLS),
        _segment(0xDA, bytes([1, 1, 0x00, 0, 63, 0])),
    )
)
