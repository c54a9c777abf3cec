"""Keyset pagination: a page continues after the last row of the previous one, whatever was added or deleted."""

import base64
import binascii
import datetime
import hashlib
import json
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict
from sqlalchemy import ColumnElement, Row, Select, bindparam, func, select, tuple_
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.exc import DataError, DBAPIError, ProgrammingError, StatementError

from kleinkram.contract.base import Cursor, Page, PageSize
from kleinkram.contract.errors import InvalidCursor
from kleinkram.server.db import Connection

T = TypeVar("T")
_TYPES: dict[str, Callable[[str], Any]] = {
    "s": str,
    "i": int,
    "d": datetime.datetime.fromisoformat,
    "u": uuid.UUID,
    "j": json.loads,
}


@dataclass(frozen=True)
class Order:
    """The total order of a list: columns that are never null, the last of them unique; one direction for all.

    Two spellings of one order share a `name`: cursors are valid for both.
    """

    columns: Sequence[ColumnElement[Any]]
    descending: bool = False
    name: str = ""

    @cached_property
    def signature(self) -> str:
        """Characters in cursors that identify the order, so that another order refuses them."""
        text = (self.name or "|".join(str(column) for column in self.columns)) + str(self.descending)
        return hashlib.sha256(text.encode()).hexdigest()[:8]


@dataclass(frozen=True)
class PageRequest:
    """Which page of a list is requested."""

    limit: int
    cursor: str | None = None
    count: bool = False


class PageQuery(BaseModel):
    """Query parameters of a list."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    limit: PageSize = 100
    cursor: Cursor | None = None

    @property
    def page(self) -> PageRequest:
        """The requested page."""
        return PageRequest(self.limit, self.cursor, getattr(self, "count", False))


class CountedPageQuery(PageQuery):
    """Query parameters of a list whose total can be requested."""

    count: bool = False


@dataclass(frozen=True)
class Rows:
    """One page of rows, the cursor of the next page, and the number of all rows where that was requested."""

    items: Sequence[Row[Any]]
    next: str | None
    total: int | None


@dataclass(frozen=True)
class PagedQuery(Generic[T]):
    """A select whose pages are read in an order, with the function that reads the rows. Its statements are built once.

    With `select_by_id`, the select only finds the ids of the page (the last column of the order), and the rows are what
    `select_by_id` selects for them.
    """

    statement: Select[Any]
    order: Order
    read: Callable[[Sequence[Row[Any]]], list[T]]
    select_by_id: Callable[[ColumnElement[Any]], Select[Any]] | None = None
    _pages: dict[tuple[int, bool], Select[Any]] = field(default_factory=dict, init=False)

    def page(self, limit: int, *, is_first: bool) -> Select[Any]:
        """Return the rows of a page and the next one; after `after_0`, `after_1`, ... where it is not the first."""
        if (limit, is_first) not in self._pages:
            order, keys = self.order, [column.label(f"_key_{at}") for at, column in enumerate(self.order.columns)]
            if self.select_by_id is None:
                built = _page_of(self.statement.add_columns(*keys), order, limit, is_first=is_first)
            else:
                ids = self.statement.with_only_columns(*keys, maintain_column_froms=True)
                page = _page_of(ids, order, limit, is_first=is_first).subquery("page")
                columns = [page.c[key.name] for key in keys]
                built = in_order(self.select_by_id(columns[-1]).add_columns(*page.c), columns, order)
            self._pages[limit, is_first] = built
        return self._pages[limit, is_first]

    @cached_property
    def count(self) -> Select[tuple[int]]:
        """The number of all rows."""
        ids = self.statement.with_only_columns(self.order.columns[-1]).order_by(None)
        return select(func.count()).select_from(ids.subquery())


async def read_listing(
    db: Connection, listing: PagedQuery[T], request: PageRequest, values: Mapping[str, object] | None = None
) -> Page[T]:
    """Read one page of a listing, whose statements are executed with `values`.

    Raises:
        InvalidCursor: the cursor is not one of this list in this order.
    """
    rows = await _fetch_rows(db, listing, request, values)
    return Page(items=listing.read(rows.items), next=rows.next, total=rows.total)


async def read_page(
    db: Connection, statement: Select[Any], order: Order, request: PageRequest, read: Callable[[Row[Any]], T]
) -> Page[T]:
    """Run a select for one page and return what `read` makes of its rows. Raises InvalidCursor."""
    return await read_listing(db, PagedQuery(statement, order, lambda rows: [read(row) for row in rows]), request)


async def fetch_page(db: Connection, statement: Select[Any], order: Order, request: PageRequest) -> Rows:
    """Run a select for one page and return its rows. Raises InvalidCursor."""
    return await _fetch_rows(db, PagedQuery[Row[Any]](statement, order, list), request, None)


async def _fetch_rows(
    db: Connection, listing: PagedQuery[Any], request: PageRequest, values: Mapping[str, object] | None
) -> Rows:
    after = values_after(request, listing.order)
    rows = await execute_after(db, listing.page(request.limit, is_first=after is None), after, values)
    items = rows[: request.limit]
    total = len(items) if request.count else None
    if request.count and (after is not None or len(rows) > request.limit):
        total = (await db.execute(listing.count, values)).scalar_one()
    return Rows(items, _encode(items[-1], listing.order) if len(rows) > request.limit else None, total)


async def execute_after(
    db: Connection, statement: Select[Any], after: Sequence[Any] | None, values: Mapping[str, object] | None = None
) -> Sequence[Row[Any]]:
    """Run a select that begins after the values of a cursor, `after_0` and so on. Raises InvalidCursor."""
    try:
        parameters = {f"after_{at}": value for at, value in enumerate(after or [])}
        return (await db.execute(statement, {**(values or {}), **parameters})).all()
    except (StatementError, UnicodeEncodeError) as error:
        is_of_database = isinstance(error, DBAPIError) and not isinstance(error, DataError | ProgrammingError)
        if after is not None and not is_of_database:
            raise InvalidCursor from error
        raise


def values_after(request: PageRequest, order: Order) -> list[Any] | None:
    """Return the values of the order's columns after which a page begins; None for the first page.

    Raises InvalidCursor.
    """
    if not request.cursor:
        return None
    try:
        signature, *values = json.loads(base64.urlsafe_b64decode(request.cursor + "=" * (-len(request.cursor) % 4)))
        decoded = [_TYPES[value[0]](value[1:]) for value in values]
    except (ValueError, TypeError, KeyError, IndexError, RecursionError, binascii.Error):
        raise InvalidCursor from None
    if signature != order.signature or len(decoded) != len(order.columns):
        raise InvalidCursor
    return decoded


def _page_of(statement: Select[Any], order: Order, limit: int, *, is_first: bool) -> Select[Any]:
    if not is_first:
        after = [bindparam(f"after_{at}", type_=column.type) for at, column in enumerate(order.columns)]
        row, last_row, first = tuple_(*order.columns), tuple_(*after), order.columns[0]
        # The first column again by itself: its index is used even if the other columns are in other tables.
        ahead = first <= after[0] if order.descending else first >= after[0]
        statement = statement.where(ahead, row < last_row if order.descending else row > last_row)
    return in_order(statement, order.columns, order).limit(limit + 1)


def in_order(statement: Select[Any], columns: Iterable[ColumnElement[Any]], order: Order) -> Select[Any]:
    """Return a select in an order of these columns, in its direction."""
    return statement.order_by(*(column.desc() if order.descending else column.asc() for column in columns))


def _encode(row: Row[Any], order: Order) -> str:
    keys = ((row._mapping[f"_key_{number}"], column.type) for number, column in enumerate(order.columns))
    values = ["j" + json.dumps(key) if isinstance(kind, JSONB) else _to_text(key) for key, kind in keys]
    return base64.urlsafe_b64encode(json.dumps([order.signature, *values]).encode()).decode().rstrip("=")


def _to_text(value: object) -> str:
    if isinstance(value, datetime.datetime):
        return "d" + value.isoformat()
    if isinstance(value, uuid.UUID):
        return "u" + str(value)
    return ("i" if isinstance(value, int) else "s") + str(value)
