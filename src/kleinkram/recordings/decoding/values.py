"""Decoded messages: small objects with the fields of their type as attributes.

Values compare by type name and fields (arrays element by element; NaN is unequal to itself, as in Python), print like
constructors, copy and pickle. The caller may change them; arrays are views of the message's bytes and read-only.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any, ClassVar

from kleinkram.recordings.decoding.types import ConstantValue, DecodeError, Struct

NS = 1_000_000_000
# Seconds and nanoseconds of ROS 2, ROS 1, protobuf, and Foxglove's JSON.
_STAMPS = (("sec", "nanosec"), ("secs", "nsecs"), ("seconds", "nanos"), ("sec", "nsec"))
Constants = tuple[tuple[str, ConstantValue], ...]


class Value:
    """A decoded message or a part of one: its fields are attributes, its constants are attributes of its class.

    `_type`: the type's name as the schema has it; `_fields`: the names of the fields, in the schema's order.
    """

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]  # a value can change
    _type: ClassVar[str] = ""
    _fields: ClassVar[tuple[str, ...]] = ()
    _constants: ClassVar[Constants] = ()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Value) or self._type != other._type or self._fields != other._fields:
            return NotImplemented
        return all(_same(getattr(self, name), getattr(other, name)) for name in self._fields)

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={getattr(self, name)!r}" for name in self._fields)
        return f"{self._type or type(self).__name__}({inside})"

    def __reduce__(self) -> tuple[object, ...]:
        values = tuple(getattr(self, name) for name in self._fields)
        return (_rebuild, (self._type, self._fields, self._constants, values))


def value_class(struct: Struct) -> type[Value]:
    """Return the class of a type's values; the same for equal types."""
    return _class(struct.name, tuple(field.name for field in struct.fields), struct.constants)


@lru_cache(maxsize=4096)
def _class(name: str, fields: tuple[str, ...], constants: Constants) -> type[Value]:
    own = {"__slots__": fields, "_type": name, "_fields": fields, "_constants": constants, "__module__": __name__}
    short = name.rpartition("/")[2]
    return type(short if short.isidentifier() else "Value", (Value,), {**dict(constants), **own})


def _rebuild(name: str, fields: tuple[str, ...], constants: Constants, values: tuple[object, ...]) -> Value:
    value = _class(name, fields, constants)()
    for field, part in zip(fields, values, strict=True):
        setattr(value, field, part)
    return value


def _same(one: object, other: object) -> bool:
    if hasattr(one, "dtype") or hasattr(other, "dtype"):
        import numpy as np

        return np.array_equal(one, other)  # type: ignore[arg-type]  # one of the two is an array
    return bool(one == other)


def to_plain(value: object) -> Any:
    """Return a decoded message of any encoding as dicts, lists, numbers, texts and bytes.

    Arrays of uint8 become `bytes`, other arrays lists. Protobuf fields keep the names of their definition; those that
    are not set are there with their default, except messages and members of a `oneof`, which are left out.
    """
    return _plain(value, dict)


def to_row(value: object) -> Any:
    """Return what `to_plain` returns, with protobuf maps as lists of `{"key": ..., "value": ...}`, as in Arrow."""
    return _plain(value, lambda pairs: [{"key": key, "value": part} for key, part in pairs])


def _plain(value: Any, as_map: Callable[[Iterator[tuple[Any, Any]]], Any]) -> Any:
    if isinstance(value, (str, bytes, int, float)) or value is None:
        return value
    if isinstance(value, Value):
        return {name: _plain(getattr(value, name), as_map) for name in value._fields}
    if isinstance(value, (list, tuple)):
        return [_plain(part, as_map) for part in value]
    if isinstance(value, dict):
        return {key: _plain(part, as_map) for key, part in value.items()}
    if hasattr(value, "DESCRIPTOR"):  # first: fields of a message can have any name
        return {name: _plain(part, as_map) for name, part in _protobuf_fields(value)}
    if hasattr(value, "tolist"):
        is_bytes = getattr(value, "dtype", None) == "uint8" or getattr(value, "typecode", None) == "B"
        return value.tobytes() if is_bytes and hasattr(value, "tobytes") else value.tolist()
    if hasattr(value, "keys"):  # protobuf's maps; reading one of a message-valued map by [] would add missing keys
        return as_map((key, _plain(value[key], as_map)) for key in sorted(value.keys()))
    if hasattr(value, "__len__") and hasattr(value, "__getitem__"):  # protobuf's repeated fields have no `__iter__`
        return [_plain(value[index], as_map) for index in range(len(value))]
    return value


def _protobuf_fields(message: Any) -> Iterator[tuple[str, object]]:
    for field in message.DESCRIPTOR.fields:
        if not field.has_presence or message.HasField(field.name):
            yield field.name, getattr(message, field.name)
    for field, value in message.ListFields():  # extensions of proto2 are no fields of the type itself
        if field.is_extension:
            yield field.full_name, value


def stamp_ns(value: object) -> int | None:
    """Return the time stamp that a message carries, in nanoseconds since 1970 by the clock that set it.

    Reads `header.stamp`, else `stamp` or `timestamp`, of a ROS 1, ROS 2, JSON or protobuf message, or a time itself.
    None where there is none. This is not the log time.

    Raises:
        DecodeError: the stamp is not a time.
    """
    stamps = (part(holder, name) for holder in (part(value, "header"), value) for name in ("stamp", "timestamp"))
    stamp = next((stamp for stamp in stamps if stamp is not None and not callable(stamp)), value)
    for seconds, nanoseconds in _STAMPS:
        whole, rest = part(stamp, seconds), part(stamp, nanoseconds)
        if whole is None or rest is None:
            continue
        try:
            return int(whole) * NS + int(rest)
        except (TypeError, ValueError, OverflowError):
            raise DecodeError("", f"'{whole!s:.40}' and '{rest!s:.40}' are not a time") from None
    return None


def part(value: object, name: str) -> Any:
    """Return a field of a decoded message of any encoding, or None."""
    return value.get(name) if isinstance(value, Mapping) else getattr(value, name, None)


def type_name(value: Any) -> str:
    """Return the name of a decoded message's type, for errors."""
    return str(getattr(value, "_type", "") or getattr(getattr(value, "DESCRIPTOR", None), "full_name", ""))


def payload(value: object) -> Any:
    """Return the field `data` as a buffer with a length in bytes; JSON carries it in base64."""
    data = part(value, "data")
    if isinstance(data, str):
        try:
            return base64.b64decode(data, validate=True)
        except binascii.Error:
            raise DecodeError(type_name(value), "its data is not base64") from None
    try:
        return memoryview(data).cast("B") if len(data) else b""
    except (TypeError, ValueError):
        raise DecodeError(type_name(value), "its data is not bytes") from None


def whole_number(value: object, name: str) -> int:
    """Return a field that is a size; anything but a non-negative integer is a `DecodeError`."""
    number = part(value, name)
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**32:
        raise DecodeError(type_name(value), f"its {name} is {str(number)[:40]}, which is not a size")
    return number
