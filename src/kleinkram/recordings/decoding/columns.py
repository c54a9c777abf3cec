"""A ROS type as the columns of a table.

Nested types become columns with dotted names, a time or duration one column of int64 nanoseconds named `..._ns`
(`header.stamp` -> `header.stamp_ns`). Arrays of fixed length are fixed-size lists, others lists; `uint8[]` is binary.
Types inside arrays are structs with the same rules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from kleinkram.recordings.decoding.errors import DecodeError
from kleinkram.recordings.decoding.types import Array, Primitive, Struct, Type

Notice = Callable[[int, DecodeError], None]
"""Called with the log time of each message that cannot be decoded, and the error."""
TIME_COLUMNS = ("log_time_ns", "publish_time_ns")
_TIME_FIELDS = {("sec", "nanosec"), ("secs", "nsecs")}


class NoSuchField(DecodeError):
    """The messages have no field of that name."""


@dataclass(frozen=True)
class TableColumn:
    """One column.

    Attributes:
        path: the places of its field, from the message inwards.
        names: the attributes by which it is reached.
    """

    name: str
    path: tuple[int, ...]
    names: tuple[str, ...]
    kind: Type


def is_time(kind: Type) -> bool:
    """Return whether a type is a time or a duration."""
    if not isinstance(kind, Struct) or kind.name.rpartition("/")[2].lower() not in ("time", "duration"):
        return False
    return tuple(field.name for field in kind.fields) in _TIME_FIELDS


def column_name(name: str, kind: Type) -> str:
    """Return the name of a field's column: its unit follows a time's."""
    return f"{name}_ns" if is_time(kind) else name


def columns_of(root: Struct, fields: Sequence[str] | None) -> list[TableColumn]:
    """Return the columns of a type; with `fields`, only those named or below a name, in the type's order.

    Raises:
        NoSuchField: a name matches no column.
    """
    columns = list(_flat(root, (), ()))
    if fields is None:
        return columns
    for name in fields:
        if not any(_is_selected(column, name) for column in columns):
            known = ", ".join(column.name for column in columns[:40])
            raise NoSuchField(root.name, f"there is no field '{name}'; there are {known}")
    return [column for column in columns if any(_is_selected(column, name) for name in fields)]


def _is_selected(column: TableColumn, name: str) -> bool:
    path = ".".join(column.names)
    return name in (column.name, path) or path.startswith(f"{name}.")


def _flat(kind: Struct, path: tuple[int, ...], names: tuple[str, ...]) -> Iterator[TableColumn]:
    for place, field in enumerate(kind.fields):
        here, called = (*path, place), (*names, field.name)
        if isinstance(field.type, Struct) and not is_time(field.type):
            yield from _flat(field.type, here, called)
        else:
            yield TableColumn(column_name(".".join(called), field.type), here, called, field.type)


def arrow_type(kind: Type) -> Any:
    """Return the Arrow type of a field."""
    import pyarrow as pa

    if isinstance(kind, Primitive):
        return _primitive(pa, kind)
    if is_time(kind):
        return pa.int64()
    if isinstance(kind, Struct):
        return pa.struct([(column_name(field.name, field.type), arrow_type(field.type)) for field in kind.fields])
    if is_bytes(kind):
        return pa.binary()
    element = arrow_type(kind.element)
    return pa.list_(element) if kind.length is None else pa.list_(element, kind.length)


def is_bytes(kind: Array) -> bool:
    """Return whether an array is stored as binary: `uint8` of variable length."""
    return kind.length is None and isinstance(kind.element, Primitive) and kind.element.name == "uint8"


def _primitive(pa: Any, kind: Primitive) -> Any:
    if not kind.code:
        return pa.string()
    return pa.bool_() if kind.code == "?" else getattr(pa, kind.name)()


def arrow_of(values: Any, valid: Any = None) -> Any:
    """Return numbers or booleans as an Arrow array that shares their memory; null where `valid` is False.

    `pa.array` would import pandas to check for a series (60 MB, half a second).
    """
    import numpy as np
    import pyarrow as pa

    bitmap = None if valid is None or valid.all() else _bits(valid)
    stored = _bits(values) if values.dtype == np.bool_ else pa.py_buffer(np.ascontiguousarray(values))
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [bitmap, stored])


def _bits(flags: Any) -> Any:
    import numpy as np
    import pyarrow as pa

    return pa.py_buffer(np.packbits(flags, bitorder="little"))


def timed_batch(log_ns: list[int], publish_ns: list[int], names: list[str], arrays: list[Any]) -> Any:
    """Return a record batch whose first columns are the times."""
    import pyarrow as pa

    times = [_times(column) for column in (log_ns, publish_ns)]
    return pa.RecordBatch.from_arrays([*times, *arrays], names=[*TIME_COLUMNS, *names])


def _times(stamps: list[int]) -> Any:
    import numpy as np

    times = np.fromiter(stamps, np.uint64, len(stamps)).view(np.int64)
    return arrow_of(times, times >= 0)
