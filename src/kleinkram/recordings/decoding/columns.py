"""A ROS type as the columns of a table.

Nested types become columns with dotted names, a time or duration one column of int64 nanoseconds named `..._ns`
(`header.stamp` -> `header.stamp_ns`). Arrays of fixed length are fixed-size lists, others lists; `uint8[]` is binary.
Types inside arrays are structs with the same rules.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from kleinkram.recordings.decoding.errors import DecodeError
from kleinkram.recordings.decoding.schema import Array, Primitive, Struct, Type

_TIME_FIELDS = {("sec", "nanosec"), ("secs", "nsecs")}


class NoSuchField(DecodeError):
    """A field was asked for that the messages do not have."""


@dataclass(frozen=True)
class Column:
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
    """Say whether a type is a time or a duration."""
    if not isinstance(kind, Struct) or kind.name.rpartition("/")[2].lower() not in ("time", "duration"):
        return False
    return tuple(field.name for field in kind.fields) in _TIME_FIELDS


def column_name(name: str, kind: Type) -> str:
    """Return the name of a field's column: its unit follows a time's."""
    return f"{name}_ns" if is_time(kind) else name


def columns_of(root: Struct, fields: Sequence[str] | None) -> list[Column]:
    """Return the columns of a type; with `fields`, those that are named or lie below a name, in the type's order.

    Raises:
        NoSuchField: a name that fits no column.
    """
    columns = list(_flat(root, (), ()))
    if fields is None:
        return columns
    found = {wanted: [column for column in columns if _fits(wanted, column)] for wanted in fields}
    for wanted, fitting in found.items():
        if not fitting:
            known = ", ".join(column.name for column in columns[:40])
            raise NoSuchField(root.name, f"there is no field '{wanted}'; there are {known}")
    return [column for column in columns if any(_fits(wanted, column) for wanted in fields)]


def _fits(wanted: str, column: Column) -> bool:
    plain = ".".join(column.names)
    return wanted == column.name or plain == wanted or plain.startswith(f"{wanted}.")


def _flat(kind: Struct, path: tuple[int, ...], names: tuple[str, ...]) -> Iterator[Column]:
    for place, field in enumerate(kind.fields):
        here, called = (*path, place), (*names, field.name)
        if isinstance(field.type, Struct) and not is_time(field.type):
            yield from _flat(field.type, here, called)
        else:
            yield Column(column_name(".".join(called), field.type), here, called, field.type)


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
    """Say whether an array is kept as bytes: `uint8` of any number."""
    return kind.length is None and isinstance(kind.element, Primitive) and kind.element.name == "uint8"


def _primitive(pa: Any, kind: Primitive) -> Any:
    if not kind.code:
        return pa.string()
    return pa.bool_() if kind.code == "?" else getattr(pa, kind.name)()
