"""Message layouts with fixed strings, compiled to one `struct` each, for ROS 1 and for CDR (ROS 2).

Fast enough for bulk: one `pack` a message. Strings and array lengths are fixed when the layout is made.

Source: ROS 1 serialisation (wiki.ros.org/msg); OMG CDR, little endian, as in DDS-XTYPES 1.2 section 7.4.1 (XCDR1).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import Enum

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"

Item = tuple[str, "float | str | None"]
"""A field: struct code (or "s" for a string) and its fixed value; None for one that is given to `pack`."""


class Encoding(str, Enum):
    """How messages are serialised."""

    ros1 = "ros1"
    cdr = "cdr"


class Layout:
    """A compiled layout: `pack` takes the values of the fields that are not fixed, in order."""

    def __init__(self, items: Sequence[Item], encoding: Encoding) -> None:
        cdr = encoding is Encoding.cdr
        self._codes = "<"
        self._size = 0
        self._values: list[float | bytes | None] = []
        for code, value in items:
            if isinstance(value, str):
                raw = value.encode() + (b"\0" if cdr else b"")
                self._add("I", len(raw), align=cdr)
                self._add(f"{len(raw)}s", raw, align=False)
            else:
                self._add(code, value, align=cdr)
        self._slots = [number for number, value in enumerate(self._values) if value is None]
        self._front = CDR_LITTLE_ENDIAN if cdr else b""
        self._struct = struct.Struct(self._codes)

    def pack(self, *given: float) -> bytes:
        """Return the serialised message, or its beginning where items are missing at the end."""
        values = self._values.copy()
        for slot, value in zip(self._slots, given, strict=True):
            values[slot] = value
        return self._front + self._struct.pack(*values)

    def _add(self, code: str, value: float | bytes | None, *, align: bool) -> None:
        size = struct.calcsize("<" + code)
        padding = -self._size % size if align else 0
        self._codes += "x" * padding + code
        self._size += padding + size
        self._values.append(value)


def header(frame_id: str, encoding: Encoding) -> list[Item]:
    """Return a std_msgs/Header whose stamp (seconds, nanoseconds) is given to `pack`; ROS 1's sequence stays 0."""
    sequence: list[Item] = [("I", 0)] if encoding is Encoding.ros1 else []
    return [*sequence, ("I", None), ("I", None), ("s", frame_id)]


def given(count: int) -> list[Item]:
    """Return float64 fields that are given to `pack`."""
    return [("d", None)] * count


def diagonal(size: int, variance: float) -> list[Item]:
    """Return a fixed covariance matrix with equal variances."""
    return [("d", variance if row == column else 0.0) for row in range(size) for column in range(size)]
