"""Metadata: the typed fields that a project declares, and the values of a mission."""

import datetime
import enum
import re
from typing import Annotated

from pydantic import AfterValidator, Field, JsonValue, model_validator
from typing_extensions import Self

from kleinkram.contract.base import Request
from kleinkram.contract.names import check_text

MAX_YAML_CHARACTERS = 200_000
MAX_DEPTH = 20
MAX_VALUES = 20_000
MAX_KEY_CHARACTERS = 200

Choice = Annotated[str, Field(max_length=200)]
FieldName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")]


class FieldType(str, enum.Enum):
    """Type of a metadata field."""

    string = "string"
    number = "number"
    boolean = "boolean"
    date = "date"
    location = "location"
    link = "link"
    choice = "choice"


class Undeclared(str, enum.Enum):
    """Treatment of metadata keys that no field declares."""

    accept = "accept"
    refuse = "refuse"


class Location(Request):
    """A place on earth in degrees (WGS 84); altitude in metres above the ellipsoid."""

    latitude: Annotated[float, Field(ge=-90, le=90)]
    longitude: Annotated[float, Field(ge=-180, le=180)]
    altitude: float | None = None
    name: str | None = None


# Dates are ISO 8601 text; a location is the mapping of `Location` or the name of a place.
Metadata = dict[str, JsonValue]


def check_values(metadata: Metadata) -> Metadata:
    """Return metadata unchanged; raise ValueError if it exceeds the limits of YAML documents."""
    values = characters = 0
    waiting: list[tuple[int, JsonValue]] = [(1, metadata)]
    while waiting:
        depth, value = waiting.pop()
        if depth > MAX_DEPTH + 1:
            raise ValueError(f"is nested more than {MAX_DEPTH} levels deep")
        texts = [value] if isinstance(value, str) else [*value] if isinstance(value, dict) else []
        if isinstance(value, dict) and any(len(key) > MAX_KEY_CHARACTERS for key in value):
            raise ValueError(f"has a key of more than {MAX_KEY_CHARACTERS} characters")
        values, characters = values + 1, characters + sum(len(check_text(text)) for text in texts)
        if values > MAX_VALUES or characters > MAX_YAML_CHARACTERS:
            raise ValueError(f"has more than {MAX_VALUES} values, or {MAX_YAML_CHARACTERS} characters")
        inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        waiting += [(depth + 1, item) for item in inside]
    return metadata


BoundedMetadata = Annotated[Metadata, AfterValidator(check_values)]


class MetadataField(Request):
    """One field that a project declares.

    `unit` is for numbers, `pattern` (Rust regex syntax, for the entire value) for strings, `choices` for choices.
    """

    name: FieldName
    type: FieldType
    required: bool = False
    unit: Annotated[str, Field(max_length=32)] | None = None
    description: Annotated[str, Field(max_length=1000)] = ""
    pattern: Annotated[str, Field(max_length=500)] | None = None
    choices: Annotated[list[Choice], Field(min_length=1, max_length=200)] | None = None
    default: bool | int | float | str | datetime.date | Location | None = None

    @model_validator(mode="after")
    def _fits_its_type(self) -> Self:
        owners = {"unit": FieldType.number, "pattern": FieldType.string, "choices": FieldType.choice}
        for attribute, owner in owners.items():
            if getattr(self, attribute) is not None and self.type is not owner:
                raise ValueError(f"{attribute!r} is only for fields of type {owner.value}")
        if self.type is FieldType.choice and self.choices is None:
            raise ValueError("a choice needs its 'choices'")
        return self


class MetadataFields(Request):
    """All fields that a project declares, as in `fields.yaml`.

    ```yaml
    undeclared: refuse
    fields:
      - {name: robot, type: choice, choices: [anymal, spot], required: true}
      - {name: temperature, type: number, unit: degC}
    ```
    """

    fields: Annotated[list[MetadataField], Field(max_length=200)] = []
    undeclared: Undeclared = Undeclared.accept

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        seen: set[str] = set()
        for field in self.fields:
            if field.name.casefold() in seen:
                raise ValueError(f"the field {field.name!r} is declared twice")
            seen.add(field.name.casefold())
        return self


WHERE_EXPRESSION = re.compile(r"(?P<field>[A-Za-z][A-Za-z0-9_.]*)\s*(?P<operator><=|>=|!=|=|<|>|~)\s*(?P<value>.+)")
