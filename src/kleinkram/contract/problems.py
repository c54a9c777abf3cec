"""Errors as problem documents (RFC 9457) and back."""

from dataclasses import fields
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

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
