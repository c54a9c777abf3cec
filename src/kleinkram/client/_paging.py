"""Lists that page by themselves: one request a page, made when the reader gets there."""

from collections.abc import Iterator
from typing import TypeVar

from pydantic import BaseModel

from kleinkram.client._http import Api, query_of
from kleinkram.contract.paging import MAX_PAGE_SIZE, Page

T = TypeVar("T", bound=BaseModel)


def pages(api: Api, path: str, kind: type[T], query: list[tuple[str, str]], *, limit: int | None = None) -> Iterator[T]:
    """Yield the rows of a list in its order, at most `limit` of them."""
    left, cursor = limit, None
    while left is None or left > 0:
        size = MAX_PAGE_SIZE if left is None else min(left, MAX_PAGE_SIZE)
        page = api.get(path, Page[kind], [*query, *query_of(None, limit=size, cursor=cursor)])  # type: ignore[valid-type]  # a generic model is made at run time
        yield from page.items
        left = None if left is None else left - len(page.items)
        cursor = page.next
        if cursor is None:
            return


def count(api: Api, path: str, kind: type[T], query: list[tuple[str, str]]) -> int:
    """Return how many rows a list has."""
    page = api.get(path, Page[kind], [*query, ("limit", "1"), ("count", "true")])  # type: ignore[valid-type]  # as above
    return page.total or 0
