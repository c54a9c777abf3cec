"""From what a caller gave to a request that can be sent, or a named error that says what is wrong with it."""

import datetime
from typing import TypeVar, cast

from pydantic import BaseModel, ValidationError

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.wording import in_plain_words

T = TypeVar("T", bound=BaseModel)
Time = int | str | datetime.datetime
"""Nanoseconds since 1970, ISO 8601 text, or a datetime; UTC where it has no zone."""

_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)


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


def as_datetime(what: str, time: object) -> datetime.datetime | None:
    """Return a time given as nanoseconds since 1970, a datetime (UTC without a zone), or ISO text; None for None.

    Raises:
        InvalidInput: it is none of these.
    """
    if time is None:
        return None
    if isinstance(time, datetime.datetime):
        return time if time.tzinfo else time.replace(tzinfo=datetime.timezone.utc)
    from kleinkram.recordings.messages import to_ns  # who gives no time does not pay for the readers

    try:
        moment: datetime.datetime = _EPOCH + datetime.timedelta(microseconds=to_ns(cast(Time, time)) // 1000)
        return moment
    except OverflowError:
        raise InvalidInput(what=f"The time {time!r} ({what})", reason="it is too far from 1970") from None
    except (TypeError, ValueError) as error:
        raise InvalidInput(what=f"The time {time!r} ({what})", reason=str(error)) from None
