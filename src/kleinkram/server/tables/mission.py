"""Missions. Span and problems are derived: from the recordings, and from the project's fields."""

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Index,
    Integer,
    Numeric,
    Table,
    Text,
    Uuid,
    cast,
    text,
)
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
    # What its files and recordings amount to, as of `derived_revision`; where files changed since, a trigger has made
    # their number null.
    Column("file_count", Integer),
    Column("size_bytes", Numeric),
    Column("message_count", Numeric),
    # Files that were not read yet, or whose recording the verification will read.
    Column("unread_count", Integer),
    Column("duration_ns", Numeric),
    created_at_column(),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    Column("deleted_at", DateTime(timezone=True)),
    Column("deleted_by_id", Uuid, ForeignKey("person.id")),
    CheckConstraint("char_length(name) BETWEEN 1 AND 128", name="name_length"),
    CheckConstraint("jsonb_typeof(metadata) = 'object'", name="metadata"),
    CheckConstraint("(start_ns IS NULL) = (end_ns IS NULL) AND start_ns <= end_ns", name="span"),
    CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name="deleted"),
    # With their ids, so that who may see which are counted by it alone.
    Index(
        "uq_mission_name_key_live",
        "project_id",
        "name_key",
        unique=True,
        postgresql_where=text("deleted_at IS NULL"),
        postgresql_include=["id"],
    ),
    # For sums over all missions that somebody sees, of which the rows themselves need not be read.
    Index(
        "ix_mission_amounts",
        "project_id",
        postgresql_where=text("deleted_at IS NULL"),
        postgresql_include=["id", "file_count", "size_bytes", "duration_ns"],
    ),
    Index("ix_mission_name", "name", "id"),
    Index("ix_mission_created_at", "created_at", "id"),
    # The order in which searches show missions: the latest first, those without a time last.
    Index("ix_mission_begun", text("coalesce(start_ns, '-9223372036854775808'::bigint)"), "id"),
    Index("ix_mission_start_ns", "start_ns", "id"),
    Index("ix_mission_metadata", "metadata", postgresql_using="gin", postgresql_ops={"metadata": "jsonb_path_ops"}),
    # For words of searches.
    Index("ix_mission_name_words", "name_key", postgresql_using="gin", postgresql_ops={"name_key": "gin_trgm_ops"}),
    Index("ix_mission_note_words", "notes", postgresql_using="gin", postgresql_ops={"notes": "gin_trgm_ops"}),
)

# As text it holds its keys too: what is found by it is looked at once more.
Index(
    "ix_mission_metadata_words",
    cast(mission.c.metadata, Text).label("said"),
    postgresql_using="gin",
    postgresql_ops={"said": "gin_trgm_ops"},
)
