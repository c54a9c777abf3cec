"""Pages: what every list answers with."""

from typing import Annotated, Generic, TypeVar

from pydantic import Field

from kleinkram.contract.wire import Response

T = TypeVar("T")

MAX_PAGE_SIZE = 500
MAX_CURSOR_CHARACTERS = 32_768
Cursor = Annotated[str, Field(max_length=MAX_CURSOR_CHARACTERS)]
PageSize = Annotated[int, Field(ge=1, le=MAX_PAGE_SIZE)]


class Page(Response, Generic[T]):
    """One page of a list, in the list's order.

    `next` is the cursor of the following page, or null on the last. `total` is the number of all rows that match, and
    is null unless it was asked for.
    """

    items: list[T]
    next: str | None = None
    total: int | None = None
