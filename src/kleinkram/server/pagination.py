"""Keyset pages: a list continues after the last row it gave, however many rows came or went in between."""

import base64
import binascii
import datetime
import hashlib
import json
import uuid
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict
from sqlalchemy import ColumnElement, Row, Select, func, literal, select, tuple_
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

    One order that is written in two ways has a `name`: a cursor of either is good for both.
    """

    columns: Sequence[ColumnElement[Any]]
    descending: bool = False
    name: str = ""

    @cached_property
    def signature(self) -> str:
        """A few characters that differ between orders, so that a cursor of one is refused by another."""
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


async def fetch_page(
    db: Connection,
    statement: Select[Any],
    order: Order,
    request: PageRequest,
    *,
    described: Callable[[ColumnElement[Any]], Select[Any]] | None = None,
) -> Rows:
    """Run a select for one page.

    With `described`, the select only finds the page, and reads no more than decides. The rows are then those that
    `described` selects for the page's ids, the last column of the order.

    Raises InvalidCursor.
    """
    after = values_after(request, order)
    keys = [column.label(f"_key_{number}") for number, column in enumerate(order.columns)]
    if described is None:
        page = _first(statement.add_columns(*keys), order, request.limit, after)
    else:
        keys_only = statement.with_only_columns(*keys, maintain_column_froms=True)
        first = _first(keys_only, order, request.limit, after).subquery("page")
        columns = [first.c[key.name] for key in keys]
        page = in_order(described(columns[-1]).add_columns(*first.c), columns, order)
    rows = await execute_after(db, page, after)
    items = rows[: request.limit]
    total = len(items) if request.count else None
    if request.count and (after is not None or len(rows) > request.limit):
        bare = statement.with_only_columns(order.columns[-1]).order_by(None)
        total = (await db.execute(select(func.count()).select_from(bare.subquery()))).scalar_one()
    return Rows(items, _encode(items[-1], order) if len(rows) > request.limit else None, total)


async def read_page(
    db: Connection, statement: Select[Any], order: Order, request: PageRequest, read: Callable[[Row[Any]], T]
) -> Page[T]:
    """Run a select for one page and return what `read` makes of its rows. Raises InvalidCursor."""
    rows = await fetch_page(db, statement, order, request)
    return Page(items=[read(row) for row in rows.items], next=rows.next, total=rows.total)


async def execute_after(db: Connection, statement: Select[Any], after: Sequence[Any] | None) -> Sequence[Row[Any]]:
    """Run a select that begins after the values of a cursor. Raises InvalidCursor."""
    try:
        return (await db.execute(statement)).all()
    except (StatementError, UnicodeEncodeError) as error:
        if after is not None and not _is_of_database(error):
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


def _first(statement: Select[Any], order: Order, limit: int, after: Sequence[Any] | None) -> Select[Any]:
    """Return the rows of a page, and one more where there are more."""
    if after is not None:
        values = [literal(value, column.type) for value, column in zip(after, order.columns, strict=True)]
        row, place, first = tuple_(*order.columns), tuple_(*values), order.columns[0]
        # The first column once more, by itself: where the others are of other tables, its index still serves.
        ahead = first <= values[0] if order.descending else first >= values[0]
        statement = statement.where(ahead, row < place if order.descending else row > place)
    return in_order(statement, order.columns, order).limit(limit + 1)


def _is_of_database(error: Exception) -> bool:
    return isinstance(error, DBAPIError) and not isinstance(error, DataError | ProgrammingError)


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
