"""From what a caller gave to a request that can be sent, or a named error that says what is wrong with it."""

from typing import TypeVar

from pydantic import BaseModel, ValidationError

from kleinkram.client.errors import InvalidInput

T = TypeVar("T", bound=BaseModel)


def checked(kind: type[T], what: str, /, **fields: object) -> T:
    """Return a request model of these fields.

    Raises:
        InvalidInput: they are not what the model takes; says which and why.
    """
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        first = error.errors()[0]
        where = " ".join(str(part) for part in first["loc"])
        reason = first["msg"].removeprefix("Value error, ")
        raise InvalidInput(what=f"{what} ({where})" if where else what, reason=reason) from None
