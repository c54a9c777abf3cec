"""Actions and their versions. A version is never updated, but for the digest that its image was first resolved to."""

from sqlalchemy import (
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    Table,
    Text,
    UniqueConstraint,
    Uuid,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.server.tables.base import created_at_column, id_column, metadata, sorted_text

action = Table(
    "action",
    metadata,
    id_column(),
    # Null: the whole lab's.
    Column("project_id", Uuid, ForeignKey("project.id", ondelete="CASCADE")),
    sorted_text("name"),
    sorted_text("name_key"),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    created_at_column(),
    Column("archived_at", DateTime(timezone=True)),
    Index(
        "uq_action_name_key_live",
        "project_id",
        "name_key",
        unique=True,
        postgresql_where=text("archived_at IS NULL"),
        postgresql_nulls_not_distinct=True,
    ),
    Index("ix_action_name", "name", "id"),
)

action_version = Table(
    "action_version",
    metadata,
    id_column(),
    # Null, with its number, where it was run without being published.
    Column("action_id", Uuid, ForeignKey("action.id", ondelete="CASCADE")),
    Column("number", Integer),
    Column("definition", JSONB, nullable=False),
    Column("definition_sha256", LargeBinary, nullable=False),
    Column("image_digest", Text),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    created_at_column(),
    UniqueConstraint("action_id", "number"),
    CheckConstraint("(action_id IS NULL) = (number IS NULL)", name="published"),
    Index(
        "uq_action_version_unpublished",
        "definition_sha256",
        unique=True,
        postgresql_where=text("action_id IS NULL"),
    ),
)
