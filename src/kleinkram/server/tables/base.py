"""Shared by all tables: names of constraints, and common columns."""

import datetime
import enum
import uuid

from sqlalchemy import CheckConstraint, Column, DateTime, MetaData, Text, Uuid, func

# Names are fixed so that errors can be told apart by constraint name and migrations can drop by name.
metadata = MetaData(
    naming_convention={
        "ix": "ix_%(column_0_N_label)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def id_column() -> Column[uuid.UUID]:
    """Return a primary key for a resource with a URL."""
    return Column("id", Uuid, primary_key=True, default=uuid.uuid4)


def created_at_column() -> Column[datetime.datetime]:
    """Return the time a row was made, by the database's clock."""
    return Column("created_at", DateTime(timezone=True), nullable=False, server_default=func.now())


def one_of(column: str, values: type[enum.Enum]) -> CheckConstraint:
    """Return the constraint that a text column holds a value of an enum."""
    listing = ", ".join(f"'{member.value}'" for member in values)
    return CheckConstraint(f"{column} IN ({listing})", name=column)


def sorted_text(name: str, *, primary_key: bool = False) -> Column[str]:
    """Return a text column that sorts by code point, the same on every machine."""
    return Column(name, Text(collation="C"), nullable=False, primary_key=primary_key)
