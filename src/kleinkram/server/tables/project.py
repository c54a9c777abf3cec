"""Projects. A name is unique among those that are not in the trash."""

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
    text,
)
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
    # Anybody may read a public project, with or without an account.
    Column("is_public", Boolean, nullable=False, server_default=text("false")),
    Column("licence", Text, nullable=False, server_default=""),
    Column("citation", Text, nullable=False, server_default=""),
    # Null where nothing bounds it.
    Column("quota_bytes", BigInteger),
    Column("quota_files", BigInteger),
    created_at_column(),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    Column("deleted_at", DateTime(timezone=True)),
    Column("deleted_by_id", Uuid, ForeignKey("person.id")),
    CheckConstraint("char_length(name) BETWEEN 1 AND 128", name="name_length"),
    CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name="deleted"),
    CheckConstraint("quota_bytes >= 0 AND quota_files >= 0", name="quota"),
    Index("ix_project_public", "id", postgresql_where=text("is_public")),
    Index("uq_project_name_key_live", "name_key", unique=True, postgresql_where=text("deleted_at IS NULL")),
    Index("ix_project_created_at", "created_at", "id"),
    # Lists by path begin with the first project.
    Index("ix_project_name", "name"),
)
