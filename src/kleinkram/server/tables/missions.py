"""Projects, missions with their topics, files and recordings.

A name is unique among the rows that are not in the trash. Spans, numbers, topics and problems of missions are derived.
"""

from sqlalchemy import (
    ARRAY,
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    Double,
    ForeignKey,
    Identity,
    Index,
    Integer,
    LargeBinary,
    Numeric,
    Table,
    Text,
    UniqueConstraint,
    Uuid,
    cast,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.files import ContentState
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

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


MAX_STORED_TOPICS = 20_000
"""Of one mission; the first ones by name."""

mission_topics = Table(
    "mission_topics",
    metadata,
    Column("mission_id", Uuid, ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True),
    # The mission's `files_revision` that they follow from.
    Column("revision", BigInteger, nullable=False),
    # The recordings that topics count by place, in the order of time.
    Column("recording_ids", ARRAY(Uuid), nullable=False),
    # Of the widest bins.
    Column("bin_ns", BigInteger, nullable=False),
)

mission_topic = Table(
    "mission_topic",
    metadata,
    Column("id", BigInteger, Identity(always=True), primary_key=True),
    Column("mission_id", Uuid, ForeignKey("mission_topics.mission_id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    Column("message_type", Text(collation="C")),
    Column("count", BigInteger),
    Column("file_count", Integer, nullable=False),
    Column("recording_count", Integer, nullable=False),
    # First and last places of ranges of `recording_ids`, both inclusive, one range after the other.
    Column("places", ARRAY(Integer), nullable=False),
    Column("first_ns", BigInteger),
    Column("last_ns", BigInteger),
    Column("rate_hz", Double),
    Column("longest_gap_ns", BigInteger),
    Column("stored_bytes", BigInteger),
    # As `recordings.message_density.pack` writes it.
    Column("density", LargeBinary),
    UniqueConstraint("mission_id", "name", "message_type", postgresql_nulls_not_distinct=True),
)


recording = Table(
    "recording",
    metadata,
    id_column(),
    Column("mission_id", Uuid, ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    # Mission-relative: the folder of a rosbag2 recording, the file or stem of others.
    sorted_text("name"),
    Column("kind", Text, nullable=False),
    Column("missing", ARRAY(Text), nullable=False, server_default="{}"),
    Column("unlisted", ARRAY(Text), nullable=False, server_default="{}"),
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
