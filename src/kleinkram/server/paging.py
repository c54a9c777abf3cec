"""Keyset pages: a list continues after the last row it gave, however many rows came or went in between."""

import base64
import binascii
import datetime
import hashlib
import json
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, bindparam, func, select, tuple_
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.exc import DataError, DBAPIError, ProgrammingError, StatementError

from kleinkram.contract.errors import InvalidCursor
from kleinkram.server.db import Connection

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
    """Which page of a list is wanted."""

    limit: int
    cursor: str | None = None
    count: bool = False

    @property
    def goes_on(self) -> bool:
        """Whether it is one after the first."""
        return bool(self.cursor)

    @property
    def alike(self) -> "PageRequest":
        """What stands for all of this length after the first, or for the first."""
        return PageRequest(self.limit, "any" if self.goes_on else None)


@dataclass(frozen=True)
class Rows:
    """One page of rows, the cursor of the next page, and the number of all rows where that was asked for."""

    items: Sequence[Row[Any]]
    next: str | None
    total: int | None


@dataclass(frozen=True)
class Listed:
    """A list in words, to be kept and asked again: a page of what is `found`, in its order.

    With `counted`, that is the number of all that is found, in words that take less time.
    """

    found: Select[Any]
    page: Select[Any]
    order: Order
    counted: Select[Any] | None = None

    @cached_property
    def count(self) -> Select[Any]:
        """Return the number of all that is found."""
        if self.counted is not None:
            return self.counted
        bare = self.found.with_only_columns(self.order.columns[-1]).order_by(None)
        return select(func.count()).select_from(bare.subquery())


def list_of(
    statement: Select[Any],
    order: Order,
    request: PageRequest,
    *,
    described: Callable[[ColumnElement[Any]], Select[Any]] | None = None,
) -> Listed:
    """Return a list of what a select finds; the same for all requests that are `alike`.

    With `described`, the select only finds the page: of what is walked past, no more is read than decides. The rows
    are then those that `described` selects for the page's ids, the last column of the order.
    """
    paged = page_of(statement, order, limit=request.limit, goes_on=request.goes_on, described=described)
    return Listed(statement, paged, order)


async def fetch_page(db: Connection, statement: Select[Any], order: Order, request: PageRequest) -> Rows:
    """Run a select for one page.

    Raises:
        InvalidCursor: the cursor is not one of this list in this order.
    """
    return await fetch_listed(db, list_of(statement, order, request), request)


async def fetch_listed(
    db: Connection, listed: Listed, request: PageRequest, values: Mapping[str, object] = MappingProxyType({})
) -> Rows:
    """Run a list for one page, with the values of what its select leaves open.

    Raises:
        InvalidCursor: the cursor is not one of this list in this order.
    """
    total = None
    if request.count:
        total = (await db.execute(listed.count, values)).scalar_one()
        if not total and not request.goes_on:  # nothing to go through everything for once more
            return Rows([], None, 0)
    rows = await rows_after(db, listed.page, listed.order, request, values)
    return cut(rows, listed.order, limit=request.limit, total=total)


async def rows_after(
    db: Connection, statement: Select[Any], order: Order, request: PageRequest, values: Mapping[str, object]
) -> Sequence[Row[Any]]:
    """Return the rows of a statement that is executed with where a page begins, and other values.

    Raises:
        InvalidCursor: the cursor is not one of a list in this order.
    """
    try:
        return (await db.execute(statement, {**values, **_begins_after(request, order)})).all()
    except (StatementError, UnicodeEncodeError) as error:
        if request.goes_on and not _is_of_database(error):
            # Well-formed, but with values that this list's columns cannot have.
            raise InvalidCursor from error
        raise


def page_of(
    statement: Select[Any],
    order: Order,
    *,
    limit: int,
    goes_on: bool = False,
    described: Callable[[ColumnElement[Any]], Select[Any]] | None = None,
    counted: bool = False,
) -> Select[Any]:
    """Return the rows of a page, for `cut`: with `described` as in `list_of`; where `counted`, each has the `total`.

    One that `goes_on` is executed with the values after which it begins.
    """
    keys = [column.label(f"_key_{number}") for number, column in enumerate(order.columns)]
    total = [func.count().over().label("total")] if counted else []
    if described is None:
        return _first(statement.add_columns(*keys, *total), order, limit, goes_on=goes_on)
    found = statement.with_only_columns(*keys, *total, maintain_column_froms=True)
    page = _first(found, order, limit, goes_on=goes_on).subquery("page")
    columns = [page.c[key.name] for key in keys]
    return in_order(described(columns[-1]).add_columns(*page.c), columns, order)


def cut(rows: Sequence[Row[Any]], order: Order, *, limit: int, total: int | None) -> Rows:
    """Return one page of rows that `page_of` has selected, which may be one more."""
    items = rows[:limit]
    return Rows(items, _encode(items[-1], order) if len(rows) > limit else None, total)


def _first(statement: Select[Any], order: Order, limit: int, *, goes_on: bool) -> Select[Any]:
    """Return the rows of a page, and one more where there are more."""
    if goes_on:
        given = [bindparam(f"after_{number}", type_=column.type) for number, column in enumerate(order.columns)]
        row, after, first = tuple_(*order.columns), tuple_(*given), order.columns[0]
        # The first column is said once more, by itself: where the others are of other tables, its index still serves.
        ahead = first <= given[0] if order.descending else first >= given[0]
        statement = statement.where(ahead, row < after if order.descending else row > after)
    return in_order(statement, order.columns, order).limit(limit + 1)


def _is_of_database(error: Exception) -> bool:
    return isinstance(error, DBAPIError) and not isinstance(error, DataError | ProgrammingError)


def in_order(statement: Select[Any], columns: Iterable[ColumnElement[Any]], order: Order) -> Select[Any]:
    """Return a select in an order of these columns, in its direction."""
    return statement.order_by(*(column.desc() if order.descending else column.asc() for column in columns))


def _begins_after(request: PageRequest, order: Order) -> dict[str, object]:
    if not request.cursor:
        return {}
    try:
        signature, *values = json.loads(base64.urlsafe_b64decode(request.cursor + "=" * (-len(request.cursor) % 4)))
        decoded = [_TYPES[value[0]](value[1:]) for value in values]
    except (ValueError, TypeError, KeyError, IndexError, RecursionError, binascii.Error):
        raise InvalidCursor from None
    if signature != order.signature or len(decoded) != len(order.columns):
        raise InvalidCursor
    return {f"after_{number}": value for number, value in enumerate(decoded)}


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
