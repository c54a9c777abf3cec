"""Columns of messages that all have one shape, without touching any message by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from kleinkram.recordings.decoding.columns import Column, arrow_type, column_name, is_bytes, is_time
from kleinkram.recordings.decoding.schema import Array, Primitive, Struct, Type
from kleinkram.recordings.decoding.shapes import Node, NoShape, Number, Numbers, Parts, Shape, Text
from kleinkram.recordings.decoding.values import NS


def gather(rows: Any, shape: Shape, columns: list[Column]) -> list[Any]:
    """Return an Arrow array for each column.

    Args:
        rows: uint8 [N, size of a message], all of one shape.
        shape: of each of them.
        columns: what is wanted.

    Raises:
        NoShape: a column that cannot be read so.
    """
    gathering = _Gathering(rows, shape.order)
    return [gathering.array(_node(shape.root, column.path), column.kind) for column in columns]


def _node(node: Node, path: tuple[int, ...]) -> Node:
    for place in path:
        if not isinstance(node, Parts):
            raise NoShape
        node = node.parts[place]
    return node


def arrow_of(values: Any, valid: Any = None) -> Any:
    """Return numbers, or booleans, as an Arrow array that shares their memory; null where `valid` is False.

    Not by `pa.array`: to ask whether it is given a series, that imports pandas (60 MB, half a second).
    """
    bitmap = None if valid is None or valid.all() else _bits(valid)
    stored = _bits(values) if values.dtype == np.bool_ else pa.py_buffer(np.ascontiguousarray(values))
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [bitmap, stored])


def _bits(flags: Any) -> Any:
    return pa.py_buffer(np.packbits(flags, bitorder="little"))


class _Gathering:
    def __init__(self, rows: Any, order: str) -> None:
        self._rows = rows
        self._order = order

    def array(self, node: Node, kind: Type) -> Any:
        """Return the values at a place of all rows."""
        if isinstance(node, Number):
            return arrow_of(self._numbers(node.offset, 1, node.kind))
        if isinstance(node, Text):
            return self._texts(node)
        if isinstance(node, Numbers) and isinstance(kind, Array):
            return self._arrays(node, kind)
        if isinstance(node, Parts) and is_time(kind):
            whole, rest = node.parts
            return arrow_of(self._integers(whole) * NS + self._integers(rest))
        if isinstance(node, Parts) and isinstance(kind, Struct) and kind.fields:
            inside = [self.array(part, field.type) for part, field in zip(node.parts, kind.fields, strict=True)]
            names = [column_name(field.name, field.type) for field in kind.fields]
            return pa.StructArray.from_arrays(inside, names=names)
        if isinstance(node, Parts) and isinstance(kind, Array):
            return self._lists(node, kind)
        raise NoShape

    def _numbers(self, offset: int, count: int, kind: Primitive) -> Any:
        """Return `count` numbers a row, one row behind the other, in the machine's byte order."""
        cut = np.ascontiguousarray(self._rows[:, offset : offset + count * kind.size]).reshape(-1)
        if kind.code == "?":
            return cut != 0
        dtype = np.dtype(f"{self._order}{kind.code}")
        return cut.view(dtype).astype(dtype.newbyteorder("="), copy=False)

    def _integers(self, node: Node) -> Any:
        if not isinstance(node, Number):
            raise NoShape
        return self._numbers(node.offset, 1, node.kind).astype(np.int64)

    def _arrays(self, node: Numbers, kind: Array) -> Any:
        values = self._numbers(node.offset, node.count, node.kind)
        if is_bytes(kind):
            buffers = [None, pa.py_buffer(self._offsets(node.count)), pa.py_buffer(values)]
            return pa.Array.from_buffers(pa.binary(), len(self._rows), buffers)
        return self._listed(arrow_of(values), node.count, kind)

    def _lists(self, node: Parts, kind: Array) -> Any:
        count, rows = len(node.parts), len(self._rows)
        if not count:
            return self._listed(pa.array([], arrow_type(kind.element)), 0, kind)
        by_place = pa.concat_arrays([self.array(part, kind.element) for part in node.parts])
        by_row = np.arange(rows * count).reshape(count, rows).T.reshape(-1)
        return self._listed(by_place.take(arrow_of(by_row)), count, kind)

    def _listed(self, values: Any, count: int, kind: Array) -> Any:
        if kind.length is not None:
            return (
                pa.FixedSizeListArray.from_arrays(values, type=arrow_type(kind)) if count else _empty(self._rows, kind)
            )
        return pa.ListArray.from_arrays(arrow_of(self._offsets(count)), values)

    def _offsets(self, length: int) -> Any:
        return np.arange(len(self._rows) + 1, dtype=np.int32) * np.int32(length)

    def _texts(self, node: Text) -> Any:
        cut = np.ascontiguousarray(self._rows[:, node.offset : node.offset + node.length])
        if (cut == cut[0]).all():
            text = str(cut[0].tobytes(), "utf-8", "replace").encode()
            return self._strings(len(text), text * len(cut))
        if (cut < 128).all():
            return self._strings(node.length, cut)
        return pa.array([str(row.tobytes(), "utf-8", "replace") for row in cut], pa.string())

    def _strings(self, length: int, joined: Any) -> Any:
        """Return texts of `length` bytes each, which stand one behind the other."""
        buffers = [None, pa.py_buffer(self._offsets(length)), pa.py_buffer(joined)]
        return pa.Array.from_buffers(pa.string(), len(self._rows), buffers)


def _empty(rows: Any, kind: Array) -> Any:
    return pa.array([[]] * len(rows), arrow_type(kind))
