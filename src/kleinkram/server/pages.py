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
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, func, literal, select, tuple_
from sqlalchemy.exc import DataError, ProgrammingError

from kleinkram.contract.errors import InvalidCursor
from kleinkram.server.db import Connection

_TYPES: dict[str, Callable[[str], Any]] = {"s": str, "i": int, "d": datetime.datetime.fromisoformat, "u": uuid.UUID}


@dataclass(frozen=True)
class Order:
    """The total order of a list: columns that are never null, the last of them unique; one direction for all."""

    columns: Sequence[ColumnElement[Any]]
    descending: bool = False

    @cached_property
    def signature(self) -> str:
        """A few characters that differ between orders, so that a cursor of one is refused by another."""
        text = "|".join(str(column) for column in self.columns) + str(self.descending)
        return hashlib.sha256(text.encode()).hexdigest()[:8]


@dataclass(frozen=True)
class PageRequest:
    """Which page of a list is wanted."""

    limit: int
    cursor: str | None = None
    count: bool = False


@dataclass(frozen=True)
class Rows:
    """One page of rows, the cursor of the next page, and the number of all rows where that was asked for."""

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

    With `described`, the select only finds the page: of what is walked past, no more is read than decides. The rows
    are then those that `described` selects for the page's ids, the last column of the order.

    Raises:
        InvalidCursor: the cursor is not one of this list in this order.
    """
    total = None
    if request.count:
        bare = statement.with_only_columns(order.columns[-1]).order_by(None)
        total = (await db.execute(select(func.count()).select_from(bare.subquery()))).scalar_one()
        if not total and not request.cursor:  # nothing to go through everything for once more
            return Rows([], None, 0)
    paged = page_of(statement, order, request, described=described)
    try:
        rows = (await db.execute(paged)).all()
    except (DataError, ProgrammingError, UnicodeEncodeError) as error:
        if request.cursor:  # well-formed, but with values that this list's columns cannot have
            raise InvalidCursor from error
        raise
    return cut(rows, order, limit=request.limit, total=total)


def page_of(
    statement: Select[Any],
    order: Order,
    request: PageRequest,
    *,
    described: Callable[[ColumnElement[Any]], Select[Any]] | None = None,
    counted: bool = False,
) -> Select[Any]:
    """Return what `fetch_page` runs for the rows of a page, for `cut`; where `counted`, each says the `total` of all.

    Raises:
        InvalidCursor: the cursor is not one of this list in this order.
    """
    keys = [column.label(f"_key_{number}") for number, column in enumerate(order.columns)]
    total = [func.count().over().label("total")] if counted else []
    if described is None:
        return _first(statement.add_columns(*keys, *total), order, request)
    found = statement.with_only_columns(*keys, *total, maintain_column_froms=True)
    page = _first(found, order, request).subquery("page")
    columns = [page.c[key.name] for key in keys]
    return in_order(described(columns[-1]).add_columns(*page.c), columns, order)


def cut(rows: Sequence[Row[Any]], order: Order, *, limit: int, total: int | None) -> Rows:
    """Return one page of rows that `page_of` has selected, which may be one more."""
    items = rows[:limit]
    return Rows(items, _encode(items[-1], order) if len(rows) > limit else None, total)


def _first(statement: Select[Any], order: Order, request: PageRequest) -> Select[Any]:
    """Return the rows of a page, and one more where there are more."""
    if request.cursor:
        given = _decode(request.cursor, order)
        after = tuple_(*(literal(value) for value in given))
        row, first = tuple_(*order.columns), order.columns[0]
        # The first column is said once more, by itself: where the others are of other tables, its index still serves.
        ahead = first <= literal(given[0]) if order.descending else first >= literal(given[0])
        statement = statement.where(ahead, row < after if order.descending else row > after)
    return in_order(statement, order.columns, order).limit(request.limit + 1)


def in_order(statement: Select[Any], columns: Iterable[ColumnElement[Any]], order: Order) -> Select[Any]:
    """Return a select in an order of these columns, in its direction."""
    return statement.order_by(*(column.desc() if order.descending else column.asc() for column in columns))


def place_of(cursor: str, order: Order) -> list[Any]:
    """Return the values of an order's columns after which the page of a cursor begins.

    Raises:
        InvalidCursor: the cursor is not one of a list in this order.
    """
    return _decode(cursor, order)


def _encode(row: Row[Any], order: Order) -> str:
    values = [_to_text(row._mapping[f"_key_{number}"]) for number in range(len(order.columns))]
    return base64.urlsafe_b64encode(json.dumps([order.signature, *values]).encode()).decode().rstrip("=")


def _to_text(value: object) -> str:
    if isinstance(value, datetime.datetime):
        return "d" + value.isoformat()
    if isinstance(value, uuid.UUID):
        return "u" + str(value)
    return ("i" if isinstance(value, int) else "s") + str(value)


def _decode(cursor: str, order: Order) -> list[Any]:
    try:
        signature, *values = json.loads(base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)))
        decoded = [_TYPES[value[0]](value[1:]) for value in values]
    except (ValueError, TypeError, KeyError, IndexError, RecursionError, binascii.Error):
        raise InvalidCursor from None
    if signature != order.signature or len(decoded) != len(order.columns):
        raise InvalidCursor
    return decoded
