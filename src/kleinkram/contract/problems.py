"""Errors as problem documents (RFC 9457) and back, and messages for fields that fail validation."""

import re
from dataclasses import fields
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from kleinkram.contract.errors import ERRORS, ErrorCode, InternalError, KleinkramError


class ProblemDocument(BaseModel):
    """A failure on the wire (RFC 9457), with the fields of the error's class beside these."""

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: int
    detail: str
    code: ErrorCode
    request_id: str | None = None


def to_problem(error: KleinkramError, request_id: str | None) -> ProblemDocument:
    """Return the problem document of an error."""
    extra: dict[str, Any] = error.fields()  # Any: pydantic's extra values are untyped by design
    return ProblemDocument(
        type=f"urn:kleinkram:error:{error.code.value}",
        title=error.code.value.replace("_", " "),
        status=error.status,
        detail=error.sentence(),
        code=error.code,
        request_id=request_id,
        **{key: value for key, value in extra.items() if key != "request_id"},
    )


def from_problem(problem: ProblemDocument) -> KleinkramError:
    """Return the error that a problem document describes.

    A newer server may leave out or add fields. A missing field makes it an `InternalError` with the request id rather
    than a wrong sentence.
    """
    cls = ERRORS[problem.code]
    values = {**(problem.model_extra or {}), "request_id": problem.request_id or "unknown"}
    names = {field.name for field in fields(cls)}
    try:
        error: KleinkramError = TypeAdapter(cls).validate_python({k: v for k, v in values.items() if k in names})
    except ValidationError:
        return InternalError(request_id=problem.request_id or "unknown")
    return error


# Types of pydantic errors, and their messages with the values of the error.
_WORDS = {
    "missing": "it is required",
    "extra_forbidden": "there is no such field",
    "enum": "it is one of {expected}",
    "literal_error": "it is one of {expected}",
    "string_too_long": "it has more than {max_length} characters",
    "string_too_short": "it is too short",
    "too_long": "there are more than {max_length}",
    "too_short": "there are fewer than {min_length}",
    "greater_than_equal": "it must be at least {ge}",
    "greater_than": "it must be more than {gt}",
    "less_than_equal": "it must be at most {le}",
    "less_than": "it must be less than {lt}",
    "finite_number": "it must be a finite number",
    "string_pattern_mismatch": "it must match {pattern}",
    "none_required": "it must not be set",
    "json_invalid": "it is not valid JSON",
    "url_scheme": "it must be an address that begins with {expected_schemes}",
}
_MEMBER = re.compile(r"<\w+\.\w+: ('[^']*')>")
# Prefixes of types of pydantic errors, and their messages.
_KINDS = {
    "string": "it must be text",
    "int": "it must be a whole number",
    "float": "it must be a number",
    "bool": "it must be true or false",
    "uuid": "it must be an id",
    "datetime": "it must be a time",
    "timezone": "it must be a time with a zone",
    "time_delta": "it must be a duration",
    "time": "it must be a time",
    "date": "it must be a date",
    "list": "it must be a list",
    "tuple": "it must be a list",
    "dict": "it must be a mapping of names to values",
    "model": "it must be a mapping of names to values",
    "path": "it must be a path",
    "url": "it must be an address",
    "ip_": "it must be an IP address or a network of them",
    "bytes": "it must be bytes",
    "union": "it has none of the allowed types",
}


def first_message(error: ValidationError) -> str:
    """Return the message of the first error."""
    return message_of(error.errors(include_url=False)[0])


def first_problem(error: ValidationError, document: str = "") -> str:
    """Return the first invalid field and its message, such as `fields.0.name: it must be text`.

    `document` is the name used for errors that concern no single field.
    """
    where = ".".join(str(part) for part in error.errors(include_url=False)[0]["loc"]) or document
    return f"{where}: {first_message(error)}" if where else first_message(error)


def message_of(problem: ErrorDetails) -> str:
    """Return the message of one of pydantic's errors; messages of our own validators are unchanged."""
    kind = problem["type"]
    if kind in {"value_error", "assertion_error"}:
        return problem["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    if kind in _WORDS:
        # Of literals that are members of an enum, pydantic shows the members, and not their values.
        return _MEMBER.sub(r"\1", _WORDS[kind].format(**problem.get("ctx", {})))
    return next((words for begins, words in _KINDS.items() if kind.startswith(begins)), "it is invalid")
