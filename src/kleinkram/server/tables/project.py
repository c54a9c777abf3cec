"""Projects. A name is unique among those that are not in the trash."""

from sqlalchemy import CheckConstraint, Column, DateTime, ForeignKey, Index, Table, Text, Uuid, text
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.server.tables.base import created_at_column, id_column, metadata, sorted_text

project = Table(
    "project",
    metadata,
    id_column(),
    sorted_text("name"),
    sorted_text("name_key"),
    Column("description", Text, nullable=False, server_default=""),
    # The contract's MetadataFields: what missions of this project must say of themselves.
    Column("metadata_fields", JSONB, nullable=False),
    created_at_column(),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    Column("deleted_at", DateTime(timezone=True)),
    Column("deleted_by_id", Uuid, ForeignKey("person.id")),
    CheckConstraint("char_length(name) BETWEEN 1 AND 128", name="name_length"),
    CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name="deleted"),
    Index("uq_project_name_key_live", "name_key", unique=True, postgresql_where=text("deleted_at IS NULL")),
    Index("ix_project_created_at", "created_at", "id"),
)
