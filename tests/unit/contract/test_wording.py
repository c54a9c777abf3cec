"""Validation errors are sentences of ours, not pydantic's."""

import datetime
import re
import uuid
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    IPvAnyNetwork,
    JsonValue,
    PostgresDsn,
    TypeAdapter,
    ValidationError,
    field_validator,
)

import kleinkram
from kleinkram.contract.problems import first_message, first_problem

_PYDANTIC = re.compile(r"Input should|Value error|Field required|Extra inputs|validation error|pydantic")


class _Part(BaseModel):
    name: str


class _Example(BaseModel):
    model_config = ConfigDict(extra="forbid")

    text: Annotated[str, Field(max_length=3, pattern="^[a-z]*$")] = ""
    number: Annotated[int, Field(ge=1, le=9)] = 1
    share: float = 0.5
    choice: Literal["a", "b"] = "a"
    moment: datetime.datetime | None = None
    span: datetime.timedelta | None = None
    one: uuid.UUID | None = None
    parts: list[_Part] = []
    network: IPvAnyNetwork | None = None
    database: PostgresDsn | None = None
    even: int = 0

    @field_validator("even")
    @classmethod
    def _is_even(cls, value: int) -> int:
        if value % 2:
            raise ValueError("is odd")
        return value


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"text": "abcd"}, "text: it has more than 3 characters"),
        ({"text": "A"}, "text: it must match ^[a-z]*$"),
        ({"text": 1}, "text: it must be text"),
        ({"number": 0}, "number: it must be at least 1"),
        ({"number": "many"}, "number: it must be a whole number"),
        ({"share": []}, "share: it must be a number"),
        ({"choice": "c"}, "choice: it is one of 'a' or 'b'"),
        ({"moment": "noon"}, "moment: it must be a time"),
        ({"span": "long"}, "span: it must be a duration"),
        ({"one": "x"}, "one: it must be an id"),
        ({"parts": {}}, "parts: it must be a list"),
        ({"parts": ["x"]}, "parts.0: it must be a mapping of names to values"),
        ({"parts": [{}]}, "parts.0.name: it is required"),
        ({"network": "here"}, "network: it must be an IP address or a network of them"),
        ({"database": "mysql://db/x"}, "database: it must be an address that begins with 'postgres', "),
        ({"even": 3}, "even: is odd"),
        ({"other": 1}, "other: there is no such field"),
        ([], "the file: it must be a mapping of names to values"),
    ],
)
def test_each_kind_of_failure_has_its_own_sentence(values: JsonValue, expected: str) -> None:
    with pytest.raises(ValidationError) as failure:
        _Example.model_validate(values)
    assert first_problem(failure.value, "the file").startswith(expected)
    assert not _PYDANTIC.search(first_problem(failure.value, "the file"))


def test_unknown_errors_are_described_by_their_type_only() -> None:
    with pytest.raises(ValidationError) as failure:
        TypeAdapter(frozenset[int]).validate_python(7)
    assert first_message(failure.value) == "it is invalid"


def test_messages_of_pydantic_are_used_in_one_module() -> None:
    sources = Path(kleinkram.__file__).parent
    passing = [
        str(path.relative_to(sources))
        for path in sources.rglob("*.py")
        if re.search(r"""\[["']msg["']\]""", path.read_text(encoding="utf-8")) and path.name != "problems.py"
    ]
    assert not passing
