"""Many rows in one statement: their columns travel as arrays, so that the statement is the same for any number.

Sent one by one, even in one round trip, each row is a statement that PostgreSQL plans, runs and ends by itself.
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


def given(columns: Sequence[ColumnClause[Any]], rows: Sequence[Mapping[str, Any]]) -> TableValuedAlias:
    """Return rows as a table with these columns, in order; rows say them by name. No column may be an array."""
    arrays = [literal([row[each.name] for row in rows], ARRAY(each.type)) for each in columns]
    named = [column(each.name, each.type) for each in columns]
    return func.unnest(*arrays).table_valued(*named, name="given").render_derived()


def insert_rows(table: Table, rows: Sequence[Mapping[str, Any]]) -> Insert:
    """Return what inserts rows, at least one and all with the same keys.

    What they do not tell, the database makes up; what Python would make up is not asked for.
    """
    return insert(table).from_select([*rows[0]], _rows(table, rows), include_defaults=False)


def upsert_rows(table: Table, rows: Sequence[Mapping[str, Any]]) -> postgresql.Insert:
    """Return the same where it matters what is there already; SQLAlchemy puts this one together anew each time."""
    return postgresql.insert(table).from_select([*rows[0]], _rows(table, rows), include_defaults=False)


def _rows(table: Table, rows: Sequence[Mapping[str, Any]]) -> Select[Any]:
    return select(given([table.c[key] for key in rows[0]], rows))
