"""Numeric fields of messages as columns of float64: those of ROS without decoding single messages (`decoding.shapes`).

Fields are scalar numbers and truth values, at any depth, and the elements of arrays of at most `MAX_ELEMENTS` numbers.
Times, bytes, texts, and arrays of types are no fields.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kleinkram.recordings.decoding import DecodeError, Decoder, to_plain
from kleinkram.recordings.decoding.shapes import Node, NoShape, Number, Numbers, Parts, Shape, shape_of
from kleinkram.recordings.decoding.tables import is_bytes, is_time
from kleinkram.recordings.decoding.types import Array, Primitive, Struct

Columns = dict[str, NDArray[np.float64]]
"""Values of a field by its path, NaN where a message has none; all of one length."""

MAX_ELEMENTS = 32
MAX_FIELDS = 128  # fields of one topic
MAX_DEPTH = 24
_MAX_LAYOUTS = 64  # sizes of messages whose layout is remembered
_MAX_SHAPES = 8  # per batch and message size
_DECODED_BEFORE_SAMPLING = 10_000  # messages without shape; from then on half of them, and so on
_TIME_KEYS = ({"sec", "nanosec"}, {"secs", "nsecs"}, {"seconds", "nanos"}, {"sec", "nsec"})


class _NumericField(NamedTuple):
    name: str
    offset: int
    dtype: np.dtype[Any]


class _RowLayout(NamedTuple):
    """Where the fields are in messages of one shape. `fixed`: bytes at `fixed_at` that all of them have."""

    fixed_at: NDArray[np.int64]
    fixed: NDArray[np.uint8]
    fields: tuple[_NumericField, ...]


class NumericColumns:
    """Reads the numeric fields of the messages of one schema. Their content never raises.

    Attributes:
        undecodable: messages that could not be decoded.
        is_sampled: some messages were not decoded, because each takes long; their rows are NaN.
    """

    def __init__(self, decoder: Decoder) -> None:
        self.undecodable = 0
        self._decoder = decoder
        self._layouts: dict[int, _RowLayout] = {}
        self._singles = 0
        self._decoded = 0
        self._stride = 1

    @property
    def is_sampled(self) -> bool:
        """Whether messages were left out."""
        return self._stride > 1

    def read(self, data: Sequence[bytes]) -> Columns:
        """Return the fields of some messages."""
        columns: Columns = {}
        single = range(len(data))
        if self._decoder.struct is not None:
            single = self._read_shaped(data, self._decoder.struct, columns)
        for position in single:
            for name, number in self._decode(data[position]):
                if name not in columns and len(columns) >= MAX_FIELDS:
                    break
                _column(columns, name, len(data))[position] = number
        return columns

    def _read_shaped(self, data: Sequence[bytes], struct: Struct, columns: Columns) -> Any:
        """Read what has a shape; return the positions of the other messages, in order."""
        sizes = np.fromiter(map(len, data), np.int64, len(data))
        single: list[int] = []
        by_size = np.argsort(sizes, kind="stable")
        for positions in np.split(by_size, np.flatnonzero(np.diff(sizes[by_size])) + 1):
            rows = np.frombuffer(b"".join([data[position] for position in positions.tolist()]), np.uint8)
            rows = rows.reshape(len(positions), int(sizes[positions[0]]))
            for _ in range(_MAX_SHAPES):
                if not len(positions):
                    break
                try:
                    layout = self._layout(struct, rows[0])
                except NoShape:
                    break
                fits = (rows[:, layout.fixed_at] == layout.fixed).all(axis=1)
                _gather(rows if fits.all() else rows[fits], layout, columns, positions[fits], len(data))
                positions, rows = positions[~fits], rows[~fits]
            single += positions.tolist()
        return sorted(single)

    def _layout(self, struct: Struct, row: NDArray[np.uint8]) -> _RowLayout:
        known = self._layouts.get(len(row))
        if known is not None and bool((row[known.fixed_at] == known.fixed).all()):
            return known
        shape = shape_of(struct, row.tobytes(), self._decoder.message_encoding)
        fixed_at = np.array(shape.fixed, np.int64)
        fields = [field for field in _fields(struct, shape.root, "", shape) if field.name]
        layout = _RowLayout(fixed_at, row[fixed_at], tuple(fields[:MAX_FIELDS]))
        if len(self._layouts) < _MAX_LAYOUTS or len(row) in self._layouts:
            self._layouts[len(row)] = layout
        return layout

    def _decode(self, raw: bytes) -> Iterator[tuple[str, float]]:
        self._singles += 1
        if self._singles % self._stride:
            return
        self._decoded += 1
        if self._decoded % _DECODED_BEFORE_SAMPLING == 0:
            self._stride *= 2
        try:
            value = to_plain(self._decoder.decode(raw))
        except DecodeError:
            self.undecodable += 1
            return
        yield from _numbers(value, "", 0)


def _column(columns: Columns, name: str, length: int) -> NDArray[np.float64]:
    if name not in columns:
        columns[name] = np.full(length, np.nan)
    return columns[name]


def _gather(
    rows: NDArray[np.uint8], layout: _RowLayout, columns: Columns, positions: NDArray[np.int64], length: int
) -> None:
    is_complete = len(positions) == length and bool((np.diff(positions) == 1).all())
    for name, offset, dtype in layout.fields:
        if name not in columns and len(columns) >= MAX_FIELDS:
            return
        values = np.ascontiguousarray(rows[:, offset : offset + dtype.itemsize]).view(dtype)[:, 0]
        if dtype.kind == "b":
            values = values.view(np.uint8) != 0
        if is_complete:
            columns[name] = values.astype(np.float64)
        else:
            _column(columns, name, length)[positions] = values


def _fields(kind: Struct, node: Parts, path: str, shape: Shape) -> Iterator[_NumericField]:
    for field, part in zip(kind.fields, node.parts, strict=True):
        name = f"{path}.{field.name}" if path else field.name
        yield from _fields_of(field.type, part, name, shape)


def _fields_of(kind: object, node: Node, name: str, shape: Shape) -> Iterator[_NumericField]:
    if isinstance(node, Number):
        yield _NumericField(name, node.offset, _dtype(shape, node.kind))
    elif isinstance(kind, Struct) and isinstance(node, Parts) and not is_time(kind):
        yield from _fields(kind, node, name, shape)
    elif isinstance(node, Numbers) and isinstance(kind, Array) and node.count <= MAX_ELEMENTS and not is_bytes(kind):
        dtype = _dtype(shape, node.kind)
        for number in range(node.count):
            yield _NumericField(f"{name}[{number}]", node.offset + number * dtype.itemsize, dtype)


def _dtype(shape: Shape, kind: Primitive) -> np.dtype[Any]:
    return np.dtype(f"{shape.order}{kind.code}")


def _numbers(value: object, path: str, depth: int) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a decoded message as plain values."""
    if isinstance(value, bool | int | float):
        try:
            yield path or "value", float(value)
        except OverflowError:  # a JSON number of hundreds of digits
            return
    elif isinstance(value, dict) and depth < MAX_DEPTH and set(value) not in _TIME_KEYS:
        for key, part in value.items():
            yield from _numbers(part, f"{path}.{key}" if path else str(key), depth + 1)
    elif isinstance(value, list) and len(value) <= MAX_ELEMENTS and all(isinstance(one, int | float) for one in value):
        for number, element in enumerate(value):
            yield from _numbers(element, f"{path}[{number}]", depth + 1)
