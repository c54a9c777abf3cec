"""Parses YAML from users: plain values only, each with its line and column.

YAML 1.2 with the core schema; dates stay text. Must never make objects, follow aliases, or grow beyond its bounds:
the text is read event by event and given up at the first thing that is not wanted. Pure; slow enough (about 1 s for
200 kB) that a server runs it in a thread.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from pydantic import JsonValue
from ruamel.yaml.error import MarkedYAMLError, StreamMark, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentEndEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)
from ruamel.yaml.reader import ReaderError

from kleinkram.contract.errors import YamlInvalid
from kleinkram.contract.metadata import MAX_DEPTH, MAX_KEY_CHARACTERS, MAX_VALUES
from kleinkram.recordings.yaml_depth import shallow_yaml

_MAX_INT = 2**63 - 1
_MAX_NUMBER_CHARACTERS = 400

_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_TRUE = frozenset({"true", "True", "TRUE"})
_FALSE = frozenset({"false", "False", "FALSE"})
_INT = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"0o[0-7]+")
_HEX = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NAN = frozenset({".nan", ".NaN", ".NAN"})

Path = tuple[str | int, ...]


@dataclass(frozen=True)
class TextPosition:
    """Where something stands in a text, counted from 1."""

    line: int
    column: int


@dataclass(frozen=True)
class Document:
    """A parsed text; `positions` maps the path of every value to the position of its key or list item."""

    value: JsonValue
    positions: dict[Path, TextPosition] = field(default_factory=dict)

    def position(self, path: Path) -> TextPosition | None:
        """Return where a value stands, or, where it is absent, the nearest thing that would hold it."""
        while path and path not in self.positions:
            path = path[:-1]
        return self.positions.get(path) if path else None


def read_yaml(text: str) -> Document:
    """Return the one document of a text; an empty text says null.

    Raises YamlInvalid.

    Source: YAML 1.2.2, chapter 10.3, core schema.
    """
    try:
        return _Builder(shallow_yaml("safe", max_depth=MAX_DEPTH).parse(text)).document()
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise _invalid(mark, error.problem or error.context or "it is not YAML") from error
    except ReaderError as error:
        before = text[: error.position]
        line, column = before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1
        raise YamlInvalid(line=line, column=column, reason=f"{_named(text, error)} cannot be kept") from error
    except (YAMLError, ValueError, OverflowError) as error:
        raise YamlInvalid(line=1, column=1, reason=str(error).splitlines()[0]) from error


def resolve_plain(text: str) -> JsonValue:
    """Return what an unquoted scalar says: null, a boolean, a number, else text. Raises ValueError."""
    if text in _NULL:
        return None
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _INFINITE.fullmatch(text) or text in _NAN:
        return float(text.replace(".", ""))
    if len(text) > _MAX_NUMBER_CHARACTERS:
        return text
    for pattern, base in ((_INT, 10), (_OCTAL, 8), (_HEX, 16)):
        if pattern.fullmatch(text):
            return _bounded_int(int(text, base))
    return float(text) if _FLOAT.fullmatch(text) else text


def _bounded_int(number: int) -> int:
    if abs(number) > _MAX_INT:
        raise ValueError("the number is too large to be kept; put it in quotes to keep it as text")
    return number


def _invalid(mark: StreamMark | None, reason: str) -> YamlInvalid:
    return YamlInvalid(line=mark.line + 1 if mark else 1, column=mark.column + 1 if mark else 1, reason=reason)


def _named(text: str, error: ReaderError) -> str:
    character = text[error.position] if error.position < len(text) else "\x00"
    return f"the character U+{ord(character):04X}"


class _Builder:
    """Turns events into values; the events are asked for one by one, so a refusal ends the reading."""

    def __init__(self, events: Iterator[Event]) -> None:
        self._events = events
        self._positions: dict[Path, TextPosition] = {}
        self._nodes = 0

    def document(self) -> Document:
        value: JsonValue = None
        documents = 0
        for event in self._events:
            if isinstance(event, DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise _invalid(event.start_mark, "a second document begins here; only one is wanted")
                value = self._value(next(self._events), ())
                end = next(self._events)
                assert isinstance(end, DocumentEndEvent)  # noqa: S101  the parser's own grammar
        return Document(value, self._positions)

    def _value(self, event: Event, path: Path) -> JsonValue:
        self._refuse_unwanted(event, path)
        if isinstance(event, MappingStartEvent):
            return self._mapping(path)
        if isinstance(event, SequenceStartEvent):
            return self._sequence(path)
        assert isinstance(event, ScalarEvent)  # noqa: S101  the parser's own grammar
        return _scalar(event)

    def _refuse_unwanted(self, event: Event, path: Path) -> None:
        self._nodes += 1
        mark = event.start_mark
        if isinstance(event, AliasEvent) or (isinstance(event, NodeEvent) and event.anchor is not None):
            raise _invalid(mark, "anchors and aliases (& and *) are not allowed; write the value out, or quote it")
        if getattr(event, "tag", None):
            raise _invalid(mark, "tags (!) are not allowed; write the plain value, or quote it")
        if self._nodes > MAX_VALUES:
            raise _invalid(mark, f"there are more than {MAX_VALUES} values")
        if len(path) > MAX_DEPTH:
            raise _invalid(mark, f"this is nested more than {MAX_DEPTH} levels deep")

    def _mapping(self, path: Path) -> JsonValue:
        mapping: dict[str, JsonValue] = {}
        for event in self._events:
            if isinstance(event, MappingEndEvent):
                break
            self._refuse_unwanted(event, path)
            if not isinstance(event, ScalarEvent):
                raise _invalid(event.start_mark, "a key must be a plain text")
            key = _storable_text(event)
            if len(key) > MAX_KEY_CHARACTERS:
                reason = f"a key of {len(key)} characters is too long; {MAX_KEY_CHARACTERS} are allowed"
                raise _invalid(event.start_mark, reason)
            if key in mapping:
                raise _invalid(event.start_mark, f"the key {key!r} is given twice")
            here = (*path, key)
            self._positions[here] = TextPosition(event.start_mark.line + 1, event.start_mark.column + 1)
            mapping[key] = self._value(next(self._events), here)
        return mapping

    def _sequence(self, path: Path) -> JsonValue:
        items: list[JsonValue] = []
        for event in self._events:
            if isinstance(event, SequenceEndEvent):
                break
            here = (*path, len(items))
            self._positions[here] = TextPosition(event.start_mark.line + 1, event.start_mark.column + 1)
            items.append(self._value(event, here))
        return items


def _scalar(event: ScalarEvent) -> JsonValue:
    text = _storable_text(event)
    if event.style is not None:  # quoted or a block: always text
        return text
    try:
        return resolve_plain(text)
    except ValueError as error:
        raise _invalid(event.start_mark, str(error)) from error


def _storable_text(event: ScalarEvent) -> str:
    text: str = event.value
    for character in text:
        if character == "\x00" or "\ud800" <= character <= "\udfff":
            raise _invalid(event.start_mark, f"the character U+{ord(character):04X} cannot be kept")
    return text
