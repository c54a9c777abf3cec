"""Shapes of ROS messages: the positions of the values in a message.

Two messages have the same shape exactly if they have the same size and the same bytes wherever a length is written, and
most messages of a topic do. Such messages form rows of a byte matrix, out of which columns are cut without decoding
single messages.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from kleinkram.recordings.decoding.types import Array, Primitive, Struct, Type
from kleinkram.recordings.decoding.wire import ENCAPSULATIONS, ROS1, Wire, is_numbers

_MAX_NODES = 1500


class NoShape(Exception):
    """The message is damaged or has too many parts; decode it separately."""


@dataclass(frozen=True)
class Number:
    """A number at an offset."""

    offset: int
    kind: Primitive


@dataclass(frozen=True)
class Text:
    """A text of `length` bytes."""

    offset: int
    length: int


@dataclass(frozen=True)
class Numbers:
    """Consecutive numbers."""

    offset: int
    count: int
    kind: Primitive


@dataclass(frozen=True)
class Parts:
    """The elements of an array, or the fields of a type, in order."""

    parts: tuple[Node, ...]


Node = Number | Text | Numbers | Parts


@dataclass(frozen=True)
class Shape:
    """The positions of the values of a message. `fixed`: offsets of all bytes that determine the shape."""

    order: str
    fixed: tuple[int, ...]
    root: Parts


def shape_of(root: Struct, data: bytes, message_encoding: str) -> Shape:
    """Return the shape of a message."""
    wire = ROS1
    if message_encoding != "ros1":
        if len(data) < 4 or data[0] or data[1] not in ENCAPSULATIONS:
            raise NoShape
        wire = ENCAPSULATIONS[data[1]]
    reader = _ShapeReader(data, wire)
    parts = reader.fields(root)
    if not reader.at <= len(data) <= reader.at + wire.padding:
        raise NoShape
    header = (0, 1) if wire.start else ()
    fixed = (*header, *(position + step for position in reader.lengths for step in range(4)))
    return Shape(wire.order, fixed, parts)


class _ShapeReader:
    def __init__(self, data: bytes, wire: Wire) -> None:
        self._data = data
        self._wire = wire
        self.at = wire.start
        self.lengths: list[int] = []
        self._nodes = 0
        self._count = struct.Struct(f"{wire.order}I")

    def fields(self, kind: Struct) -> Parts:
        if not kind.fields:
            self.at += self._wire.empty_size if self.at < len(self._data) else 0
        return Parts(tuple(self._read(field.type) for field in kind.fields))

    def _read(self, kind: Type) -> Node:
        self._nodes += 1
        if self._nodes > _MAX_NODES:
            raise NoShape
        if isinstance(kind, Struct):
            return self.fields(kind)
        if isinstance(kind, Array):
            return self._array(kind)
        if kind.code:
            self._align(kind.size)
            self.at += kind.size
            return Number(self.at - kind.size, kind)
        if kind.name == "wstring":
            raise NoShape
        length = self._length()
        self.at += length
        return Text(self.at - length, max(0, length - self._wire.counts_nul))

    def _array(self, kind: Array) -> Node:
        if not is_numbers(kind) and self._wire.has_lengths:
            self._length()
        count = self._length() if kind.length is None else kind.length
        if not is_numbers(kind):
            if count > _MAX_NODES:
                raise NoShape
            return Parts(tuple(self._read(kind.element) for _ in range(count)))
        if not isinstance(kind.element, Primitive):
            raise NoShape
        if count:
            self._align(kind.element.size)
        self.at += count * kind.element.size
        return Numbers(self.at - count * kind.element.size, count, kind.element)

    def _length(self) -> int:
        self._align(4)
        try:
            (length,) = self._count.unpack_from(self._data, self.at)
        except struct.error:
            raise NoShape from None
        self.lengths.append(self.at)
        self.at += 4
        return int(length)

    def _align(self, size: int) -> None:
        size = min(size, self._wire.alignment)
        self.at += (self._wire.start - self.at) % size
