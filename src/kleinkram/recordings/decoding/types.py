"""Types of a schema in any language, bounds on schemas and messages, and errors of decoding.

A `Struct` contains its nested types themselves, never names, so a type cannot contain itself. Build one only with
`resolve`, which checks the bounds: schemas and messages are untrusted.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from kleinkram.recordings.errors import RecordingError

MAX_SCHEMA_BYTES = 2 * 2**20
"""Bytes of one schema's text. The largest ROS types have about 100 KB with all that they need."""

MAX_TYPES = 2000  # types that one schema may define
MAX_FIELDS = 6000  # fields of a type after all nested types are written out: this bounds the size of generated code
MAX_DEPTH = 24  # how deep types may nest
MAX_LOOPS = 12  # how deep arrays of types may nest: Python allows 20 blocks in one function
MAX_ARRAY = 2**31  # elements of an array of fixed length
MAX_OBJECTS = 1_000_000  # objects (nested values and arrays) that one message may turn into: at most about 200 MB
MAX_JSON_VALUES = 2_000_000  # values in one JSON message, by the commas and brackets in it
MAX_JSON_DEPTH = 100  # how deep JSON may nest

MAX_IMAGE_PIXELS = 64_000_000
"""Pixels of one picture: above any camera on a robot, far below what a compressed bomb unpacks to."""

MAX_POINT_FIELDS = 1000  # fields of a point in a cloud
BATCH_MESSAGES = 65_536  # messages of one batch of a table
BATCH_BYTES = 16 * 2**20  # bytes of messages that are collected for one batch of a table


class SchemaError(RecordingError):
    """A schema cannot be followed. Never leaves `decoding`: it becomes an `Undecodable`."""


class DecodeError(RecordingError):
    """A message's bytes contradict its schema, or a value is of another kind. `offset`: in the message, or None."""

    def __init__(self, type_name: str, message: str, *, offset: int | None = None) -> None:
        where = "" if offset is None else f" (near byte {offset} of the message)"
        super().__init__(f"{type_name or 'a message'}: {message}{where}")
        self.type_name = type_name
        self.offset = offset

    def __reduce__(self) -> tuple[object, ...]:
        return (_unpickled, (str(self), self.type_name, self.offset))


def _unpickled(text: str, type_name: str, offset: int | None) -> DecodeError:
    error = DecodeError(type_name, "", offset=offset)
    error.args = (text,)
    return error


class ReadingExtraMissing(RecordingError):
    """A library of the extra `reading` is not installed."""

    def __init__(self, library: str) -> None:
        super().__init__(f"this needs {library}: run `pip install 'open-kleinkram[reading]'`")
        self.library = library

    def __reduce__(self) -> tuple[object, ...]:
        return (ReadingExtraMissing, (self.library,))


@dataclass(frozen=True)
class Undecodable:
    """Why messages of a schema cannot be decoded; their bytes can still be read."""

    type_name: str
    reason: str


_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
MAX_IDENTIFIER = 255

ConstantValue = bool | int | float | str


@dataclass(frozen=True)
class Primitive:
    """A number, a truth value or a text. `code`: as in `struct`; empty for texts. `size`: on the wire; 0 for texts."""

    name: str
    code: str
    size: int


@dataclass(frozen=True, eq=False)
class Array:
    """Elements of one type; `length` is None where the message has their number."""

    element: Type
    length: int | None


@dataclass(frozen=True)
class Field:
    """A named part of a type. `name` is safe as a Python attribute."""

    name: str
    type: Type


@dataclass(frozen=True, eq=False)
class Struct:
    """A type with fields. `field_count`: with all nested types written out. `loops`: how deep arrays of types nest."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[tuple[str, ConstantValue], ...]
    field_count: int
    loops: int


Type = Primitive | Array | Struct

PRIMITIVES = {
    name: Primitive(name, code, size)
    for name, code, size in (
        ("bool", "?", 1),
        ("int8", "b", 1),
        ("uint8", "B", 1),
        ("int16", "h", 2),
        ("uint16", "H", 2),
        ("int32", "i", 4),
        ("uint32", "I", 4),
        ("int64", "q", 8),
        ("uint64", "Q", 8),
        ("float32", "f", 4),
        ("float64", "d", 8),
        ("string", "", 0),
        ("wstring", "", 0),
    )
}


@dataclass(frozen=True)
class FieldText:
    """A field as written: the name of its type, and its lengths from the inside out (None: any)."""

    name: str
    type_name: str
    lengths: tuple[int | None, ...]


@dataclass(frozen=True)
class Definition:
    """A type as written."""

    name: str
    fields: tuple[FieldText, ...]
    constants: tuple[tuple[str, ConstantValue], ...] = ()


FindType = Callable[[str, str], "Primitive | Definition | None"]
"""(name of a type, name of the type that mentions it) -> what it is."""


def identifier(name: str) -> str:
    """Return a name that is safe as a Python attribute: as written, or with "_" behind a word of Python."""
    if len(name) > MAX_IDENTIFIER or not _IDENTIFIER.match(name):
        raise SchemaError(f"'{name[:60]}' is not a name that a field can have")
    return f"{name}_" if keyword.iskeyword(name) else name


def resolve(root: Definition, find: FindType) -> Struct:
    """Build a type from definitions."""
    return _Resolver(find).struct(root, ())


class _Resolver:
    def __init__(self, find: FindType) -> None:
        self._find = find
        self._done: dict[str, Struct] = {}

    def struct(self, definition: Definition, above: tuple[str, ...]) -> Struct:
        if definition.name in self._done:
            return self._done[definition.name]
        if definition.name in above:
            raise SchemaError(f"{definition.name} contains itself")
        if len(above) >= MAX_DEPTH:
            raise SchemaError(f"types nest more than {MAX_DEPTH} deep")
        above = (*above, definition.name)
        fields: dict[str, Type] = {}
        for text in definition.fields:
            name = identifier(text.name)
            if name in fields:
                raise SchemaError(f"{definition.name} has two fields '{name}'")
            fields[name] = self._type(text, definition.name, above)
        count = 1 + sum(_field_count(kind) for kind in fields.values())
        loops = max(map(_loops, fields.values()), default=0)
        if count > MAX_FIELDS or loops > MAX_LOOPS:
            raise SchemaError(f"{definition.name} has more than {MAX_FIELDS} fields, or arrays nest {MAX_LOOPS} deep")
        parts = tuple(Field(name, kind) for name, kind in fields.items())
        constants = tuple((name, value) for name, value in definition.constants if name not in fields)
        self._done[definition.name] = Struct(definition.name, parts, constants, count, loops)
        return self._done[definition.name]

    def _type(self, text: FieldText, owner: str, above: tuple[str, ...]) -> Type:
        definition = self._find(text.type_name, owner)
        if definition is None:
            raise SchemaError(f"the type {text.type_name[:100]} of {owner}.{text.name} is not defined")
        kind: Type = definition if isinstance(definition, Primitive) else self.struct(definition, above)
        for length in text.lengths:
            if length is not None and not 0 <= length <= MAX_ARRAY:
                raise SchemaError(f"{owner}.{text.name} has {length} elements")
            kind = Array(kind, length)
        if len(text.lengths) > MAX_LOOPS:
            raise SchemaError(f"{owner}.{text.name} is an array in {len(text.lengths)} dimensions")
        return kind


def _field_count(kind: Type) -> int:
    if isinstance(kind, Struct):
        return kind.field_count
    return 1 + _field_count(kind.element) if isinstance(kind, Array) else 1


def _loops(kind: Type) -> int:
    if isinstance(kind, Struct):
        return kind.loops
    if isinstance(kind, Array):
        is_numbers = isinstance(kind.element, Primitive) and bool(kind.element.code)
        return 0 if is_numbers else 1 + _loops(kind.element)
    return 0


def constants_of(pairs: Mapping[str, ConstantValue]) -> tuple[tuple[str, ConstantValue], ...]:
    """Return the constants whose names can be attributes."""
    return tuple((identifier(name), value) for name, value in pairs.items() if _IDENTIFIER.match(name))


Layout = tuple[object, ...]  # what decoding depends on: equal for definitions that differ only in how they are written


def layout_of(kind: Type) -> Layout:
    """Return the layout of a type: names and types of its fields, all the way down."""
    if isinstance(kind, Primitive):
        return (kind.name,)
    if isinstance(kind, Array):
        return ("array", kind.length, layout_of(kind.element))
    return (kind.name.rpartition("/")[2], *((field.name, layout_of(field.type)) for field in kind.fields))
