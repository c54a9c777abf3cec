"""The messages of a sample mission: definitions in ROS 1 and ROS 2, and layouts compiled to one `struct` each.

Strings and array lengths are fixed when a layout is made, so that a message is one `pack`.

Source: wiki.ros.org/msg (ROS 1 serialisation); OMG CDR, little endian, as in DDS-XTYPES 1.2 section
7.4.1 (XCDR1).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import Enum
from functools import cache

from kleinkram.recordings.decoding.msg_definitions import known_definitions
from kleinkram.recordings.decoding.ros_versions import ROS1_TEXTS, full_definition, md5sum_of


def ros2_definition(message_type: str) -> str:
    """Return the definition of a type with all that it needs, as an MCAP with schema encoding "ros2msg" has it."""
    return full_definition(message_type, {name: texts[0] for name, texts in known_definitions().items()})


def ros1_definition(message_type: str) -> str:
    """Return the definition of a type with all that it needs, as a bag has it."""
    return full_definition(message_type, _ros1_texts())


def _ros1_texts() -> dict[str, str]:
    return {name: texts[0] for name, texts in known_definitions().items()} | ROS1_TEXTS


def ros2_name(message_type: str) -> str:
    """Return the ROS 2 name of a type: "sensor_msgs/Imu" -> "sensor_msgs/msg/Imu"."""
    return message_type.replace("/", "/msg/")


@cache
def ros1_md5(message_type: str) -> str:
    """Return the md5 sum by which ROS 1 identifies a type."""
    return md5sum_of(message_type, _ros1_texts())


CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"

Item = tuple[str, "float | str | None"]
"""A field: struct code (or "s" for a string) and its fixed value; None for an argument of `pack`."""


class Encoding(str, Enum):
    """Serialisation of messages."""

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

    def pack(self, *arguments: float) -> bytes:
        """Return the serialised message, or its beginning where items are missing at the end."""
        values = self._values.copy()
        for slot, value in zip(self._slots, arguments, strict=True):
            values[slot] = value
        return self._front + self._struct.pack(*values)

    def _add(self, code: str, value: float | bytes | None, *, align: bool) -> None:
        size = struct.calcsize("<" + code)
        padding = -self._size % size if align else 0
        self._codes += "x" * padding + code
        self._size += padding + size
        self._values.append(value)


def header(frame_id: str, encoding: Encoding) -> list[Item]:
    """Return a std_msgs/Header whose stamp (seconds, nanoseconds) is packed; the sequence number of ROS 1 stays 0."""
    sequence: list[Item] = [("I", 0)] if encoding is Encoding.ros1 else []
    return [*sequence, ("I", None), ("I", None), ("s", frame_id)]


def variable(count: int) -> list[Item]:
    """Return float64 fields whose values are arguments of `pack`."""
    return [("d", None)] * count


def diagonal(size: int, variance: float) -> list[Item]:
    """Return a fixed covariance matrix with equal variances."""
    return [("d", variance if row == column else 0.0) for row in range(size) for column in range(size)]
