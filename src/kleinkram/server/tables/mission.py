"""Missions. Span and problems are derived: from the recordings, and from the project's fields."""

from sqlalchemy import BigInteger, CheckConstraint, Column, DateTime, ForeignKey, Index, Table, Text, Uuid, text
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.server.tables.base import created_at_column, id_column, metadata, sorted_text

mission = Table(
    "mission",
    metadata,
    id_column(),
    Column("project_id", Uuid, ForeignKey("project.id"), nullable=False),
    sorted_text("name"),
    sorted_text("name_key"),
    Column("metadata", JSONB, nullable=False),
    # The submitted document to the letter, comments included.
    Column("metadata_yaml", Text),
    Column("metadata_problems", JSONB, nullable=False, server_default="[]"),
    Column("notes", Text, nullable=False, server_default=""),
    Column("completed_at", DateTime(timezone=True)),
    Column("start_ns", BigInteger),
    Column("end_ns", BigInteger),
    # How often the set of files or what is known of them changed, and the count up to which recordings were derived.
    Column("files_revision", BigInteger, nullable=False, server_default="0"),
    Column("derived_revision", BigInteger, nullable=False, server_default="0"),
    created_at_column(),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    Column("deleted_at", DateTime(timezone=True)),
    Column("deleted_by_id", Uuid, ForeignKey("person.id")),
    CheckConstraint("char_length(name) BETWEEN 1 AND 128", name="name_length"),
    CheckConstraint("jsonb_typeof(metadata) = 'object'", name="metadata"),
    CheckConstraint("(start_ns IS NULL) = (end_ns IS NULL) AND start_ns <= end_ns", name="span"),
    CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name="deleted"),
    Index(
        "uq_mission_name_key_live", "project_id", "name_key", unique=True, postgresql_where=text("deleted_at IS NULL")
    ),
    Index("ix_mission_created_at", "created_at", "id"),
    Index("ix_mission_start_ns", "start_ns", "id"),
    Index("ix_mission_metadata", "metadata", postgresql_using="gin", postgresql_ops={"metadata": "jsonb_path_ops"}),
)
