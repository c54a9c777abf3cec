"""Files and the recordings that they make up."""

from sqlalchemy import (
    ARRAY,
    BigInteger,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Index,
    Table,
    Text,
    UniqueConstraint,
    Uuid,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.files import ContentState
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

recording = Table(
    "recording",
    metadata,
    id_column(),
    Column("mission_id", Uuid, ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    # Mission-relative: the folder of a rosbag2 recording, the file or stem of others.
    sorted_text("name"),
    Column("kind", Text, nullable=False),
    Column("missing", ARRAY(Text), nullable=False, server_default="{}"),
    Column("surplus", ARRAY(Text), nullable=False, server_default="{}"),
    Column("problems", JSONB, nullable=False, server_default="[]"),
    Column("message_count", BigInteger),
    Column("start_ns", BigInteger),
    Column("end_ns", BigInteger),
    Column("content", Text, nullable=False, server_default=ContentState.pending.value),
    Column("content_reason", Text),
    Column("lost", JSONB(none_as_null=True)),
    UniqueConstraint("mission_id", "name", "kind"),
    one_of("content", ContentState),
    CheckConstraint("start_ns <= end_ns", name="span"),
)

file = Table(
    "file",
    metadata,
    id_column(),
    Column("mission_id", Uuid, ForeignKey("mission.id"), nullable=False),
    # A recording is derived from its files; dropping it never takes one with it.
    Column("recording_id", Uuid, ForeignKey("recording.id", ondelete="SET NULL"), index=True),
    Column("blob_id", Uuid, ForeignKey("blob.id"), nullable=False, index=True),
    # That of its blob. Triggers keep it.
    Column("start_ns", BigInteger),
    sorted_text("path"),
    sorted_text("path_key"),
    Column("origin", Text, nullable=False),
    Column("uploaded_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    Column("labels", ARRAY(Text), nullable=False, server_default="{}"),
    created_at_column(),
    Column("deleted_at", DateTime(timezone=True)),
    Column("deleted_by_id", Uuid, ForeignKey("person.id")),
    CheckConstraint("char_length(path) BETWEEN 1 AND 1024", name="path_length"),
    CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name="deleted"),
    CheckConstraint("origin IN ('upload', 'link', 'run')", name="origin"),
    Index("uq_file_path_key_live", "mission_id", "path_key", unique=True, postgresql_where=text("deleted_at IS NULL")),
    Index("ix_file_path", "mission_id", "path", "id"),
    Index("ix_file_created_at", "created_at", "id"),
    # The order in which searches show files: the latest first, those without a time last. What decides whether a file
    # is shown stands in it too.
    Index(
        "ix_file_begun",
        text("coalesce(start_ns, '-9223372036854775808'::bigint)"),
        "id",
        postgresql_where=text("deleted_at IS NULL"),
        postgresql_include=["start_ns", "blob_id", "mission_id"],
    ),
    Index("ix_file_deleted_at", "deleted_at", postgresql_where=text("deleted_at IS NOT NULL")),
    Index("ix_file_labels", "labels", postgresql_using="gin"),
    # For words of searches: two, so that one alone tells whether a word is in any path of a file that has a time.
    Index(
        "ix_file_words_timed",
        "path_key",
        postgresql_using="gin",
        postgresql_ops={"path_key": "gin_trgm_ops"},
        postgresql_where=text("start_ns IS NOT NULL"),
    ),
    Index(
        "ix_file_words_untimed",
        "path_key",
        postgresql_using="gin",
        postgresql_ops={"path_key": "gin_trgm_ops"},
        postgresql_where=text("start_ns IS NULL"),
    ),
)

Index(
    "ix_file_label_words",
    func.joined(file.c.labels).label("joined"),
    postgresql_using="gin",
    postgresql_ops={"joined": "gin_trgm_ops"},
)
