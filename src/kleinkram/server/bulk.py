"""Inserts of many rows in one statement: columns travel as arrays, so the statement is the same for any row count.

Rows that are sent one by one cost PostgreSQL a plan and an execution each, even in one round trip.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import (
    ARRAY,
    ColumnClause,
    Insert,
    Select,
    Table,
    TableValuedAlias,
    column,
    func,
    insert,
    literal,
    select,
)
from sqlalchemy.dialects import postgresql


def unnest_rows(columns: Sequence[ColumnClause[Any]], rows: Sequence[Mapping[str, Any]]) -> TableValuedAlias:
    """Return rows, keyed by column name, as a table with these columns in order. No column may be an array."""
    arrays = [literal([row[col.name] for row in rows], ARRAY(col.type)) for col in columns]
    named = [column(col.name, col.type) for col in columns]
    return func.unnest(*arrays).table_valued(*named, name="rows").render_derived()


def insert_rows(table: Table, rows: Sequence[Mapping[str, Any]]) -> Insert:
    """Return an INSERT of rows, at least one and all with the same keys.

    Columns without a value take the database's default; Python-side defaults do not apply.
    """
    return insert(table).from_select([*rows[0]], _select(table, rows), include_defaults=False)


def upsert_rows(table: Table, rows: Sequence[Mapping[str, Any]]) -> postgresql.Insert:
    """Return the same as PostgreSQL's INSERT, to which ON CONFLICT can be added. SQLAlchemy does not cache it."""
    return postgresql.insert(table).from_select([*rows[0]], _select(table, rows), include_defaults=False)


def _select(table: Table, rows: Sequence[Mapping[str, Any]]) -> Select[Any]:
    return select(unnest_rows([table.c[key] for key in rows[0]], rows))
