"""From what a caller gave to a request that can be sent, or a named error that says what is wrong with it."""

import datetime
from typing import TypeVar, cast

from pydantic import BaseModel, ValidationError

from kleinkram.client.errors import InvalidInput

T = TypeVar("T", bound=BaseModel)
Time = int | str | datetime.datetime
"""Nanoseconds since 1970, ISO 8601 text, or a datetime; UTC where it has no zone."""

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
# What pydantic calls a failure -> what is wanted instead, with its own numbers.
_WORDS = {
    "missing": "it is needed, and was not given",
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
    "finite_number": "it must be a finite number, neither NaN nor infinite",
    "string_pattern_mismatch": "it must match {pattern}",
    "none_required": "it cannot be given",
}
# The beginning of what pydantic calls a failure of a kind.
_KINDS = {
    "string": "it must be text",
    "int": "it must be a whole number",
    "float": "it must be a number",
    "bool": "it must be true or false",
    "uuid": "it must be an id",
    "datetime": "it must be a time",
    "timezone": "it must be a time with a zone",
    "time": "it must be a time",
    "date": "it must be a date",
    "list": "it must be a list",
    "dict": "it must be a mapping of names to values",
    "model": "it must be of the right kind",
    "path": "it must be a path",
    "url": "it must be an address",
    "bytes": "it must be bytes",
    "union": "it is of none of the kinds that are allowed",
}


def checked(kind: type[T], what: str, /, **fields: object) -> T:
    """Return a request model of these fields.

    Raises:
        InvalidInput: they are not what the model takes; says which and why.
    """
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise invalid(what, error) from None


def invalid(what: str, error: ValidationError) -> InvalidInput:
    """Return the named error for fields that a model does not take, about the first that is wrong."""
    where = " ".join(str(part) for part in error.errors(include_url=False)[0]["loc"])
    return InvalidInput(what=f"{what} ({where})" if where else what, reason=in_plain_words(error))


def in_plain_words(error: ValidationError) -> str:
    """Return what is wrong with the first of several wrong fields, as a sentence."""
    first = error.errors(include_url=False)[0]
    kind, context = first["type"], first.get("ctx", {})
    if kind in {"value_error", "assertion_error"}:
        return first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    if kind in _WORDS:
        return _WORDS[kind].format(**context)
    return next((words for begins, words in _KINDS.items() if kind.startswith(begins)), "it is not usable")


def as_datetime(what: str, time: object) -> datetime.datetime | None:
    """Return a time given as nanoseconds since 1970, a datetime (UTC without a zone), or ISO text; None for None.

    Raises:
        InvalidInput: it is none of these.
    """
    if time is None:
        return None
    if isinstance(time, datetime.datetime):
        return time if time.tzinfo else time.replace(tzinfo=datetime.timezone.utc)
    from kleinkram.recordings.reading.times import to_ns  # who gives no time does not pay for the readers

    try:
        moment: datetime.datetime = _EPOCH + datetime.timedelta(microseconds=to_ns(cast(Time, time)) // 1000)
        return moment
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(what=f"The time {time!r} ({what})", reason=str(error)) from None
