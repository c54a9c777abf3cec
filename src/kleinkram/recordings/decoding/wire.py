"""Serialisation formats of messages: ROS 1, and CDR in its plain forms.

Source: wiki.ros.org/ROS/Technical Overview (little-endian, nothing aligned, lengths of 4 bytes); OMG DDS-XTypes 1.3
section 7.4 (encapsulation header of 4 bytes, alignment counted from behind it; XCDR2 aligns to at most 4 and puts a
length in front of arrays of anything but numbers); rosidl (a type without fields holds one byte in CDR).
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kleinkram.recordings.decoding.types import Array, Primitive, Struct, Type


@dataclass(frozen=True)
class Wire:
    """One way of laying out values.

    Attributes:
        order: "<" or ">", as in `struct`.
        start: the byte of a message at which its first field begins, from which alignment counts.
        alignment: the most that a number is aligned to; 1 if nothing is.
        counts_nul: the length of a text counts a closing zero byte.
        empty_size: bytes of a type without fields.
        has_lengths: arrays of anything but numbers have their length in bytes in front.
        padding: the most bytes that may follow the last field.
    """

    order: str
    start: int
    alignment: int
    counts_nul: bool
    empty_size: int
    has_lengths: bool
    padding: int


ROS1 = Wire("<", 0, 1, counts_nul=False, empty_size=0, has_lengths=False, padding=0)
CDR_BE = Wire(">", 4, 8, counts_nul=True, empty_size=1, has_lengths=False, padding=3)
CDR_LE = Wire("<", 4, 8, counts_nul=True, empty_size=1, has_lengths=False, padding=3)
CDR2_BE = Wire(">", 4, 4, counts_nul=True, empty_size=1, has_lengths=True, padding=3)
CDR2_LE = Wire("<", 4, 4, counts_nul=True, empty_size=1, has_lengths=True, padding=3)

ENCAPSULATIONS = {0: CDR_BE, 1: CDR_LE, 6: CDR2_BE, 7: CDR2_LE}  # by the second byte of a CDR message; the first is 0

OTHER_ENCAPSULATIONS = {
    2: "PL_CDR (big-endian)",
    3: "PL_CDR (little-endian)",
    8: "D_CDR2 (big-endian)",
    9: "D_CDR2 (little-endian)",
    10: "PL_CDR2 (big-endian)",
    11: "PL_CDR2 (little-endian)",
}
"""Known, and not read: their layout depends on the extensibility of types, which ROS schemas do not state."""


def min_size(kind: Type, wire: Wire) -> int:
    """Return the fewest bytes that a value can take, without alignment: what bounds how many there can be."""
    if isinstance(kind, Primitive):
        return kind.size or 4
    if isinstance(kind, Array):
        return 4 if kind.length is None else kind.length * min_size(kind.element, wire)
    return sum(min_size(field.type, wire) for field in kind.fields) if kind.fields else wire.empty_size


def object_count(kind: Type) -> int:
    """Return how many objects a value of a type is made of, without what the message itself counts."""
    if isinstance(kind, Struct):
        return 1 + sum(object_count(field.type) for field in kind.fields)
    if isinstance(kind, Array):
        inside = 0 if kind.length is None else kind.length * object_count(kind.element)
        return 1 + (0 if is_numbers(kind) else inside)
    return 0


def is_numbers(kind: Array) -> bool:
    """Return whether an array is one of numbers or truth values."""
    return isinstance(kind.element, Primitive) and bool(kind.element.code)


_CODE_POINTS = 0x110000


@dataclass(frozen=True)
class NumberReader:
    """Reads arrays of numbers and of truth values (`flags`) by the `form` of a primitive; `nothing`: an empty one."""

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
        values = array(code)
        values.frombytes(data[offset : offset + length])
        if is_swapped:
            values.byteswap()
        return values

    def flags(data: bytes, code: Any, count: int, offset: int) -> Any:
        return [byte != 0 for byte in numbers(data, "B", count, offset)]

    def nothing(code: Any) -> Any:
        return [] if code == "?" else array(code)

    return NumberReader(lambda kind: kind.code, numbers, flags, nothing)


def read_wide(data: bytes, offset: int, count: int, is_little: bool) -> tuple[str, int]:
    """Read a wide text with the length `count`; returns it and the offset behind it.

    Two layouts are in use, and nothing in the message identifies them: Fast-CDR 1 (ROS 2 Humble and before) counts
    characters and writes 4 bytes each; DDS-XTypes 1.2 and later counts bytes of UTF-16. The first is taken where all of
    its characters are ones that can be, which UTF-16 text of two characters or more practically never is.
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
