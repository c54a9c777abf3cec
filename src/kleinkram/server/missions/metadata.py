"""Validation of mission metadata by the fields that a project declares, and the YAML template to fill in. Pure.

All problems are found at once. Accepted values are returned as they are stored: numbers without their unit, times in
UTC, absent fields with their defaults.
"""

import difflib
import json
import math
import re
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import HttpUrl, JsonValue, StringConstraints, TypeAdapter, ValidationError

from kleinkram.contract.errors import FieldProblem, MetadataInvalid, YamlInvalid
from kleinkram.contract.metadata import FieldType, Location, Metadata, MetadataField, MetadataFields, Undeclared
from kleinkram.contract.problems import first_message
from kleinkram.server.filters.dates import iso_text
from kleinkram.untrusted_yaml import Document, Path, read_yaml, resolve_plain

_WITH_UNIT = re.compile(
    r"([-+]?(?:\d{1,300}(?:\.\d{0,300})?|\.\d{1,300})(?:[eE][-+]?\d{1,3})?)\s*([^\s\d.].*)", re.ASCII
)
_URL: TypeAdapter[HttpUrl] = TypeAdapter(HttpUrl)
_KINDS: dict[type, str] = {bool: "true or false", int: "a number", float: "a number", str: "text", list: "a list"}
_MAX_INT = 2**63 - 1
# Finding similar names takes cubic time: only for the first problems, and for names of usual length.
_HINTS, _HINT_CHARACTERS, _HINT_CANDIDATES = 10, 40, 200
# Problems are stored for every mission, so that they name only part of a long list of choices.
_LISTED = 20


@dataclass(frozen=True)
class Suggestion:
    """An unknown word, and a similar known one."""

    written: str
    candidates: tuple[str, ...]

    def hint(self) -> str:
        """Return the closest candidate as a question; empty where none is close, or the text is long."""
        short = [candidate for candidate in self.candidates if len(candidate) <= _HINT_CHARACTERS]
        if len(self.written) > _HINT_CHARACTERS:
            return ""
        closest = difflib.get_close_matches(self.written, short[:_HINT_CANDIDATES], n=1)
        return f"; did you mean {closest[0]!r}?" if closest else ""


class InvalidValue(ValueError):
    """A value does not fit its field, with the reason. `path` leads to the invalid part of the value."""

    def __init__(self, message: str, path: Path = (), near: Suggestion | None = None) -> None:
        super().__init__(message)
        self.path = path
        self.near = near


@dataclass(frozen=True)
class ValidationResult:
    """Validated metadata of a mission, and their problems."""

    metadata: Metadata
    problems: list[FieldProblem]


class MetadataValidator:
    """Validates metadata of many missions by the fields of one project."""

    def __init__(self, fields: MetadataFields) -> None:
        """Compile the patterns.

        Raises:
            pydantic_core.SchemaError: a pattern is not a regular expression.
        """
        self._fields = {field.name: field for field in fields.fields}
        self._folded = {name.casefold(): name for name in self._fields}
        self._undeclared = fields.undeclared
        self._accept = {field.name: _acceptor(field) for field in fields.fields}

    def validate(self, document: Document) -> ValidationResult:
        """Return what to store of a document whose value is a mapping, and every problem in it, in its order."""
        values = document.value if isinstance(document.value, dict) else {}
        metadata: Metadata = {}
        problems: list[FieldProblem] = []
        for key, value in values.items():
            if problem := self._keep(metadata, key, value, document, hinting=len(problems) < _HINTS):
                problems.append(problem)
        problems.sort(key=lambda problem: (problem.line or 0, problem.column or 0))
        self._complete(values, metadata, problems)
        return ValidationResult(metadata, problems)

    def accept(self, name: str, value: JsonValue) -> JsonValue:
        """Return a value of a declared field as it is stored.

        Raises:
            InvalidValue: it does not fit the field.
        """
        return self._accept[name](value)

    def accept_default(self, field: MetadataField) -> JsonValue:
        """Return a field's default as it is stored.

        Raises:
            InvalidValue: it does not fit the field.
        """
        default: JsonValue = field.model_dump(mode="json", exclude_none=True).get("default")
        return None if default is None else self._accept[field.name](default)

    def _keep(
        self, metadata: Metadata, key: str, value: JsonValue, document: Document, *, hinting: bool
    ) -> FieldProblem | None:
        try:
            accepted = self._accepted(key, value)
        except InvalidValue as wrong:
            path = (key, *wrong.path)
            position = document.position(path)
            where = {"line": position.line, "column": position.column} if position else {}
            hint = wrong.near.hint() if wrong.near and hinting else ""
            return FieldProblem(field=".".join(map(str, path)), message=f"{wrong}{hint}", **where)
        if accepted is not None or key not in self._fields:
            metadata[key] = accepted
        return None

    def _accepted(self, key: str, value: JsonValue) -> JsonValue:
        if key in self._fields:
            return None if value is None or value == "" else self._accept[key](value)
        if spelled := self._folded.get(key.casefold()):
            raise InvalidValue(f"is spelled {spelled!r} in this project")
        if self._undeclared is Undeclared.refuse:
            raise InvalidValue("is not a field of this project", near=Suggestion(key, tuple(self._fields)))
        return _finite(value, ())

    def _complete(self, values: Mapping[str, JsonValue], metadata: Metadata, problems: list[FieldProblem]) -> None:
        for name, field in self._fields.items():
            if values.get(name) not in (None, ""):
                continue
            default = self.accept_default(field)
            if default is not None:
                metadata[name] = default
            elif field.required:
                how = "is required but empty" if name in values else "is required but missing"
                problems.append(FieldProblem(field=name, message=f"{how}; it takes {describe(field)}"))


def read_metadata(text: str | None) -> Document:
    """Parse a metadata document; without one, or with an empty one, return an empty mapping.

    Raises:
        YamlInvalid: it cannot be read, or is not a mapping of fields.
    """
    document = read_yaml(text or "")
    if document.value is None:
        return Document({})
    if not isinstance(document.value, dict):
        reason = f"the document is {_kind(document.value)}; it must say FIELD: VALUE, one a line"
        raise YamlInvalid(line=1, column=1, reason=reason)
    return document


def satisfying(document: Document, fields: MetadataFields) -> Metadata:
    """Return what to store of a document that must satisfy a project's fields.

    Raises:
        MetadataInvalid: it does not; names every missing, wrong or unknown field.
    """
    result = MetadataValidator(fields).validate(document)
    if result.problems:
        raise MetadataInvalid(problems=result.problems)
    return result.metadata


def describe(field: MetadataField) -> str:
    """Describe the values that a field takes."""
    if field.type is FieldType.number:
        return f"a number in {field.unit}" if field.unit else "a number"
    if field.type is FieldType.choice:
        return f"one of: {', '.join(field.choices or [])}"
    if field.type is FieldType.string and field.pattern is not None:
        return f"text that matches {field.pattern}"
    return {
        FieldType.string: "text",
        FieldType.boolean: "true or false",
        FieldType.date: "a date like 2024-05-31, or with time like 2024-05-31T14:00Z",
        FieldType.location: "a place's name, or {latitude: DEGREES, longitude: DEGREES}",
        FieldType.link: "an address that begins with http:// or https://",
    }[field.type]


Acceptor = Callable[[JsonValue], JsonValue]


def _acceptor(field: MetadataField) -> Acceptor:
    """Return the function that gives a value in its stored form, or raises InvalidValue."""
    if field.type is FieldType.string:
        return _string(field.pattern)
    if field.type is FieldType.number:
        return lambda value: _number(value, field.unit)
    if field.type is FieldType.choice:
        return lambda value: _choice(value, field.choices or [])
    simple: dict[FieldType, Acceptor] = {
        FieldType.boolean: _boolean,
        FieldType.date: _date,
        FieldType.location: _location,
        FieldType.link: _link,
    }
    return simple[field.type]


def _kind(value: JsonValue) -> str:
    return "empty" if value is None else _KINDS.get(type(value), "a mapping")


def _text(value: JsonValue, expected: str) -> str:
    if isinstance(value, str):
        return value
    hint = "; put it in quotes" if isinstance(value, bool | int | float) else ""
    raise InvalidValue(f"is {_kind(value)}, but {expected} is wanted{hint}")


def _string(pattern: str | None) -> Acceptor:
    if pattern is None:
        return lambda value: _text(value, "text")
    # Rust's engine, linear in time. First by itself, so that no pattern can break out of the group around it.
    TypeAdapter(Annotated[str, StringConstraints(pattern=pattern)])
    whole: TypeAdapter[str] = TypeAdapter(Annotated[str, StringConstraints(pattern=rf"\A(?:{pattern})\z")])

    def accept(value: JsonValue) -> JsonValue:
        text = _text(value, "text")
        try:
            return whole.validate_python(text)
        except ValidationError:
            raise InvalidValue(f"is {text!r}, which does not match the pattern {pattern}") from None

    return accept


def _number(value: JsonValue, unit: str | None) -> JsonValue:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InvalidValue(f"is {_kind(value)}, but a number is wanted")
    if not isinstance(value, str):
        return _finite(value, ())
    match = _WITH_UNIT.fullmatch(value.strip())
    if match is None:
        raise InvalidValue(f"is the text {value!r}, but a number is wanted")
    unit_in_text = unicodedata.normalize("NFC", match[2].strip())
    if unit is None:
        raise InvalidValue(f"is given in {unit_in_text!r}, but this field has no unit")
    if unit_in_text != unicodedata.normalize("NFC", unit):
        raise InvalidValue(f"is given in {unit_in_text!r}, but this field is in {unit!r}")
    number = match[1]
    return _finite(int(number) if number.lstrip("+-").isdigit() else float(number), ())


def _boolean(value: JsonValue) -> JsonValue:
    if not isinstance(value, bool):
        shown = f"the text {value!r}" if isinstance(value, str) else _kind(value)
        raise InvalidValue(f"is {shown}; write true or false")
    return value


def _listing(choices: list[str]) -> str:
    more = len(choices) - _LISTED
    return ", ".join(choices[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _choice(value: JsonValue, choices: list[str]) -> JsonValue:
    text = _text(value, f"one of {_listing(choices)}")
    if text not in choices:
        raise InvalidValue(f"is {text!r}, which is none of: {_listing(choices)}", near=Suggestion(text, tuple(choices)))
    return text


def _date(value: JsonValue) -> JsonValue:
    stored = iso_text(value.strip()) if isinstance(value, str) else None
    if stored is None:
        shown = repr(value) if isinstance(value, str) else _kind(value)
        raise InvalidValue(f"is {shown}; write a date like 2024-05-31, or with time like 2024-05-31T14:00Z")
    return stored


def _location(value: JsonValue) -> JsonValue:
    if isinstance(value, str):
        return value
    if not isinstance(value, dict):
        raise InvalidValue(f"is {_kind(value)}; write a place's name, or latitude and longitude in degrees")
    _finite(value, ())
    try:
        location = Location.model_validate(value, strict=True)
    except ValidationError as error:
        raise InvalidValue(first_message(error), tuple(error.errors()[0]["loc"])) from None
    stored: JsonValue = location.model_dump(mode="json", exclude_none=True)
    return stored


def _link(value: JsonValue) -> JsonValue:
    text = _text(value, "an address")
    try:
        _URL.validate_python(text)
    except ValidationError:
        raise InvalidValue("is not an address: write it like https://example.org/path") from None
    return text


def _finite(value: JsonValue, path: Path) -> JsonValue:
    """Return a value after checking that JSON can represent it, with everything in it."""
    if isinstance(value, float) and not math.isfinite(value):
        raise InvalidValue("is not a finite number", path)
    if isinstance(value, int) and abs(value) > _MAX_INT:
        raise InvalidValue("is too large a number to be kept", path)
    if isinstance(value, list):
        for index, item in enumerate(value):
            _finite(item, (*path, index))
    if isinstance(value, dict):
        for key, item in value.items():
            _finite(item, (*path, key))
    return value


_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*( [A-Za-z0-9_.-]+)*")
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
_DATED = re.compile(r"\d{4}-\d{2}-\d{2}([T ].*)?")
# Fields whose values differ from one mission to the next, whatever their type.
_OF_ONE_MISSION = frozenset({"date", "day", "time", "weather", "operator", "operators", "driver", "pilot"})
_NAME_PARTS = re.compile(r"[a-z]+|[A-Z][a-z]*")


def defaults(fields: MetadataFields) -> Metadata:
    """Return the default values that the project declares."""
    validator = MetadataValidator(fields)
    values = {field.name: validator.accept_default(field) for field in fields.fields}
    return {name: value for name, value in values.items() if value is not None}


def carried_over(fields: MetadataFields, last: Metadata) -> Metadata:
    """Return the values of the last mission that are still valid; the author of the next mission has to confirm them.

    Dates, weather and operator are left out: they differ, and a wrong one would look as if it had been entered.
    """
    validator = MetadataValidator(fields)
    own_defaults = defaults(fields)
    declared = {field.name: field for field in fields.fields}
    known = {name.casefold() for name in declared}
    carried: Metadata = {}
    for name, value in last.items():
        field = declared.get(name)
        if value is None or _differs(name, value) or (field is not None and field.type is FieldType.date):
            continue
        if field is not None:
            try:
                carried[name] = validator.accept(name, value)
            except InvalidValue:
                continue
        elif fields.undeclared is Undeclared.accept and name.casefold() not in known:
            carried[name] = value
    return {name: value for name, value in carried.items() if own_defaults.get(name) != value}


def _differs(name: str, value: JsonValue) -> bool:
    parts = {part.lower() for part in _NAME_PARTS.findall(name)}
    return not parts.isdisjoint(_OF_ONE_MISSION) or (isinstance(value, str) and _DATED.fullmatch(value) is not None)


def write_template(
    fields: MetadataFields, values: Metadata, carried: Metadata, *, project: str, source: str | None
) -> str:
    """Return a document that parses, and that satisfies the fields once the required ones are filled in.

    `values` are filled in. `carried` are values of the mission named `source`: they are comments, so that no value of
    an earlier mission is used unless somebody writes it.
    """
    lines = [f"# Metadata of a mission in project {_comment(project)}."]
    lines.append("# Fill in what is required; what is optional may stay empty or be deleted.")
    mission = _comment(source or "")
    for field in fields.fields:
        lines += ["", *_explained(field)]
        if field.name in carried:
            lines.append(f"#   In mission {mission}: {_yaml(carried[field.name])}")
        lines.append(_line(field.name, values.get(field.name)))
    declared = {field.name for field in fields.fields}
    others = {key: value for key, value in carried.items() if key not in declared}
    if others:
        lines += ["", f"# Not declared by the project, but given for mission {mission}. Remove the # to say it again:"]
        lines += [f"# {_line(key, value)}" for key, value in others.items()]
    return "\n".join(lines) + "\n"


def _explained(field: MetadataField) -> list[str]:
    need = "required" if field.required else "optional"
    lines = [f"# {field.name} ({need}): {_comment(describe(field))}"]
    return lines + [f"#   {_comment(line)}" for line in field.description.splitlines() if line.strip()]


def _line(key: str, value: JsonValue) -> str:
    return f"{_yaml(key)}:" if value is None else f"{_yaml(key)}: {_yaml(value)}"


def _yaml(value: JsonValue) -> str:
    if isinstance(value, str):
        plain = _DATE.fullmatch(value) or (_PLAIN.fullmatch(value) and resolve_plain(value) == value)
        return value if plain else _quoted(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_yaml(key)}: {_yaml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    return json.dumps(value)


def _quoted(text: str) -> str:
    quoted = json.dumps(text, ensure_ascii=False)
    return "".join(character if character.isprintable() else f"\\U{ord(character):08X}" for character in quoted)


def _comment(text: str) -> str:
    return "".join(character if character.isprintable() else " " for character in text)
