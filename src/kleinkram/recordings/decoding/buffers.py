"""Numbers and wide texts out of a message's bytes: as numpy arrays where numpy is installed, else as `array.array`.

Nothing is allocated for a length that the bytes do not have.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kleinkram.recordings.decoding.schema import Primitive

_CODE_POINTS = 0x110000


@dataclass(frozen=True)
class NumberReader:
    """Functions that read arrays.

    Attributes:
        form: a primitive -> what `numbers` and `flags` take as their second argument.
        numbers: (data, form, count, offset) -> array; ValueError where the bytes are not there.
        flags: the same for truth values.
        nothing: form -> an array without elements.
    """

    form: Callable[[Primitive], Any]
    numbers: Callable[[bytes, Any, int, int], Any]
    flags: Callable[[bytes, Any, int, int], Any]
    nothing: Callable[[Any], Any]


def number_reader(order: str) -> NumberReader:
    """Return how to read arrays of numbers in "<" or ">" order."""
    try:
        import numpy as np
    except ImportError:
        return _plain(order)

    # Any byte but 0 is true; a view as truth values would keep the other bits.
    def flags(data: bytes, form: Any, count: int, offset: int) -> Any:
        return np.frombuffer(data, np.uint8, count, offset) != 0

    def form(kind: Primitive) -> Any:
        return np.dtype(f"{order}{kind.code}")

    return NumberReader(form, np.frombuffer, flags, lambda dtype: np.empty(0, dtype))


def _plain(order: str) -> NumberReader:
    is_swapped = (order == "<") != (sys.byteorder == "little")

    def numbers(data: bytes, code: Any, count: int, offset: int) -> Any:
        length = struct.calcsize(f"<{code}") * count
        if offset + length > len(data):
            raise ValueError("too few bytes")
        found = array(code)
        found.frombytes(data[offset : offset + length])
        if is_swapped:
            found.byteswap()
        return found

    def flags(data: bytes, code: Any, count: int, offset: int) -> Any:
        return [byte != 0 for byte in numbers(data, "B", count, offset)]

    def nothing(code: Any) -> Any:
        return [] if code == "?" else array(code)

    return NumberReader(lambda kind: kind.code, numbers, flags, nothing)


def read_wide(data: bytes, offset: int, count: int, is_little: bool) -> tuple[str, int]:
    """Read a wide text whose length says `count`; returns it and the offset behind it.

    Two layouts are in use and nothing tells which: Fast-CDR 1 (ROS 2 Humble and before) counts characters and writes
    4 bytes each; DDS-XTypes 1.2 and later counts bytes of UTF-16. The first is taken where all of its characters are
    ones that can be, which UTF-16 text of two characters or more practically never is.

    Raises:
        ValueError: neither fits.
    """
    wide = bytes(data[offset : offset + 4 * count])
    if len(wide) == 4 * count:
        points = struct.unpack(f"{'<' if is_little else '>'}{count}I", wide)
        if all(0 < point < _CODE_POINTS for point in points):
            return wide.decode("utf-32-le" if is_little else "utf-32-be", "replace"), offset + 4 * count
    narrow = bytes(data[offset : offset + count])
    if count % 2 or len(narrow) < count:
        raise ValueError("no wide text")
    return narrow.decode("utf-16-le" if is_little else "utf-16-be", "replace"), offset + count
