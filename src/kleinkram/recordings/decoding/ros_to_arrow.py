"""Decodes ROS messages into Arrow batches: messages of one shape are read together, the others one by one.

Messages of one shape (`shapes`) form rows of a byte matrix, and the columns of the table are cut out of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from kleinkram.recordings.decoding import tables
from kleinkram.recordings.decoding.decoder import Decoder
from kleinkram.recordings.decoding.shapes import Node, NoShape, Number, Numbers, Parts, Shape, Text, shape_of
from kleinkram.recordings.decoding.tables import TableColumn, arrow_of, arrow_type
from kleinkram.recordings.decoding.types import Array, DecodeError, Primitive, Struct, Type
from kleinkram.recordings.decoding.values import NS, Value

_MAX_SHAPES = 32  # per batch and message size
_MIN_ROWS = 16  # fewer messages are decoded one by one


def gather(rows: Any, shape: Shape, columns: list[TableColumn]) -> list[Any]:
    """Return an Arrow array for each column. `rows`: uint8 [N, size of a message], all of one shape."""
    reader = _ColumnReader(rows, shape.order)
    return [reader.array(_node(shape.root, column.path), column.kind) for column in columns]


def _node(node: Node, path: tuple[int, ...]) -> Node:
    for position in path:
        if not isinstance(node, Parts):
            raise NoShape
        node = node.parts[position]
    return node


class _ColumnReader:
    def __init__(self, rows: Any, order: str) -> None:
        self._rows = rows
        self._order = order

    def array(self, node: Node, kind: Type) -> Any:
        if isinstance(node, Number):
            return arrow_of(self._numbers(node.offset, 1, node.kind))
        if isinstance(node, Text):
            return self._texts(node)
        if isinstance(node, Numbers) and isinstance(kind, Array):
            return self._arrays(node, kind)
        if isinstance(node, Parts) and tables.is_time(kind):
            whole, rest = node.parts
            return arrow_of(self._integers(whole) * NS + self._integers(rest))
        if isinstance(node, Parts) and isinstance(kind, Struct) and kind.fields:
            inside = [self.array(part, field.type) for part, field in zip(node.parts, kind.fields, strict=True)]
            names = [tables.column_name(field.name, field.type) for field in kind.fields]
            return pa.StructArray.from_arrays(inside, names=names)
        if isinstance(node, Parts) and isinstance(kind, Array):
            return self._lists(node, kind)
        raise NoShape

    def _numbers(self, offset: int, count: int, kind: Primitive) -> Any:
        """Return `count` numbers per row, row after row, in native byte order."""
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
        if tables.is_bytes(kind):
            buffers = [None, pa.py_buffer(self._offsets(node.count)), pa.py_buffer(values)]
            return pa.Array.from_buffers(pa.binary(), len(self._rows), buffers)
        return self._listed(arrow_of(values), node.count, kind)

    def _lists(self, node: Parts, kind: Array) -> Any:
        count, rows = len(node.parts), len(self._rows)
        if not count:
            return self._listed(pa.array([], arrow_type(kind.element)), 0, kind)
        by_position = pa.concat_arrays([self.array(part, kind.element) for part in node.parts])
        by_row = np.arange(rows * count).reshape(count, rows).T.reshape(-1)
        return self._listed(by_position.take(arrow_of(by_row)), count, kind)

    def _listed(self, values: Any, count: int, kind: Array) -> Any:
        if kind.length is not None:
            if not count:
                return pa.array([[]] * len(self._rows), arrow_type(kind))
            return pa.FixedSizeListArray.from_arrays(values, type=arrow_type(kind))
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
        buffers = [None, pa.py_buffer(self._offsets(length)), pa.py_buffer(joined)]
        return pa.Array.from_buffers(pa.string(), len(self._rows), buffers)


class TypedRows:
    """Builds batches of one ROS type: messages of one shape together, the rest one by one."""

    def __init__(self, decoder: Decoder, struct: Struct, columns: list[TableColumn], notice: tables.Notice) -> None:
        self._decoder = decoder
        self._struct = struct
        self._columns = columns
        self._notice = notice

    def __call__(self, log_ns: list[int], publish_ns: list[int], data: list[bytes]) -> Any:
        """Return the batch of some messages."""
        groups: list[tuple[Any, list[Any]]] = []
        single: list[int] = []
        sizes = np.fromiter(map(len, data), np.int64, len(data))
        by_size = np.argsort(sizes, kind="stable")
        ends = np.flatnonzero(np.diff(sizes[by_size])) + 1
        for positions in np.split(by_size, ends) if len(data) else ():
            single += self._shaped(positions, data, groups).tolist()
        if single or not groups:
            single.sort()
            values = [self._decoded(log_ns[position], data[position]) for position in single]
            groups.append((np.array(single, np.int64), [_column(column, values) for column in self._columns]))
        if len(groups) == 1:
            return tables.timed_batch(log_ns, publish_ns, [c.name for c in self._columns], groups[0][1])
        order = arrow_of(np.argsort(np.concatenate([positions for positions, _ in groups]), kind="stable"))
        joined = [pa.concat_arrays([arrays[n] for _, arrays in groups]).take(order) for n in range(len(self._columns))]
        return tables.timed_batch(log_ns, publish_ns, [c.name for c in self._columns], joined)

    def _shaped(self, positions: Any, data: list[bytes], groups: list[tuple[Any, list[Any]]]) -> Any:
        """Read messages of one size by shape; return the indices of those that are left."""
        if len(positions) < _MIN_ROWS:
            return positions
        rows = np.frombuffer(b"".join([data[position] for position in positions.tolist()]), np.uint8)
        rows = rows.reshape(len(positions), -1)
        for _ in range(_MAX_SHAPES):
            try:
                shape = shape_of(self._struct, rows[0].tobytes(), self._decoder.message_encoding)
                fixed = list(shape.fixed)
                fits = (rows[:, fixed] == rows[0, fixed]).all(axis=1)
                if fits.sum() < _MIN_ROWS:
                    return positions
                is_complete = bool(fits.all())
                groups.append((positions[fits], gather(rows if is_complete else rows[fits], shape, self._columns)))
            except NoShape:
                return positions
            positions, rows = positions[~fits], rows[~fits]
            if len(positions) < _MIN_ROWS:
                return positions
        return positions

    def _decoded(self, log_ns: int, data: bytes) -> Value | None:
        try:
            return self._decoder.decode(data)  # type: ignore[return-value]  # a type with a layout makes values
        except DecodeError as error:
            self._notice(log_ns, error)
            return None


def _column(column: TableColumn, values: list[Any]) -> Any:
    """Return one column of decoded messages (None: undecodable)."""
    for name in column.names:
        values = [None if value is None else getattr(value, name, None) for value in values]
    return pa.array([None if value is None else _cell(column.kind, value) for value in values], arrow_type(column.kind))


def _cell(kind: Type, value: Any) -> Any:
    """Return a value for Arrow; None where the definition of another release lacks the field."""
    if value is None:
        return None
    if tables.is_time(kind):
        whole, rest = (getattr(value, name) for name in value._fields)
        return whole * NS + rest
    if isinstance(kind, Struct):
        return {
            tables.column_name(field.name, field.type): _cell(field.type, getattr(value, field.name, None))
            for field in kind.fields
        }
    if isinstance(kind, Array):
        if tables.is_bytes(kind):
            return value.tobytes()
        if hasattr(value, "dtype"):
            return value if value.dtype.isnative else value.astype(value.dtype.newbyteorder("="))
        return [_cell(kind.element, part) for part in value]
    return value
