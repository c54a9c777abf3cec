"""Scrubs: each a comparison of what the store lists with what the database knows of it."""

from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Index,
    Table,
    Text,
    Uuid,
    false,
    func,
)

from kleinkram.server.tables.base import created_at_column, id_column, metadata


def _count(name: str) -> "Column[int]":
    return Column(name, BigInteger, nullable=False, server_default="0")


scrub = Table(
    "scrub",
    metadata,
    id_column(),
    Column("store_id", Text, nullable=False),
    # Null where it was due by itself.
    Column("asked_by_id", Uuid, ForeignKey("person.id")),
    # Whoever asked has looked, and says that so many objects are gone indeed.
    Column("believes", Boolean, nullable=False, server_default=false()),
    created_at_column(),
    Column("started_at", DateTime(timezone=True)),
    # When it was last at work: who finds it long ago takes it up again.
    Column("seen_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("ended_at", DateTime(timezone=True)),
    # Why it stopped and marked nothing; null where it went through.
    Column("stopped", Text),
    _count("compared"),
    _count("compared_bytes"),
    _count("lost"),
    _count("corrupt"),
    _count("found"),
    _count("unknown"),
    CheckConstraint("stopped IS NULL OR ended_at IS NOT NULL", name="stopped"),
    Index("ix_scrub_created_at", "store_id", "created_at"),
)
