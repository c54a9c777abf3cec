"""Tables of projects, missions with their topics, files and recordings.

Names are unique among rows outside the trash. Spans, sums, topics and problems of missions are derived.
"""

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.files import ContentState
from kleinkram.contract.isolation import Isolation
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

project = sa.Table(
    "project",
    metadata,
    id_column(),
    sorted_text("name"),
    sorted_text("name_key"),
    sa.Column("description", sa.Text, nullable=False, server_default=""),
    # MetadataFields of the contract: the metadata that missions of this project must have.
    sa.Column("metadata_fields", JSONB, nullable=False),
    # Everybody may read a public project, with or without an account.
    sa.Column("is_public", sa.Boolean, nullable=False, server_default=sa.text("false")),
    sa.Column("licence", sa.Text, nullable=False, server_default=""),
    sa.Column("citation", sa.Text, nullable=False, server_default=""),
    # Null for no quota.
    sa.Column("quota_bytes", sa.BigInteger),
    sa.Column("quota_files", sa.BigInteger),
    # The weakest isolation that its runs may have, on a server with several accounts.
    sa.Column("isolation", sa.Text, nullable=False, server_default=Isolation.container.value),
    # The version of its `checks.yaml` that applies; 0 for none.
    sa.Column("checks_number", sa.Integer, nullable=False, server_default="0"),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.Column("deleted_at", sa.DateTime(timezone=True)),
    sa.Column("deleted_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    sa.CheckConstraint("char_length(name) BETWEEN 1 AND 128", name="name_length"),
    sa.CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name="deleted"),
    one_of("isolation", Isolation),
    sa.CheckConstraint("quota_bytes >= 0 AND quota_files >= 0", name="quota"),
    sa.Index("ix_project_public", "id", postgresql_where=sa.text("is_public")),
    sa.Index("uq_project_name_key_live", "name_key", unique=True, postgresql_where=sa.text("deleted_at IS NULL")),
    sa.Index("ix_project_created_at", "created_at", "id"),
    # For lists in the order of paths, which start with the project.
    sa.Index("ix_project_name", "name"),
)


mission = sa.Table(
    "mission",
    metadata,
    id_column(),
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id"), nullable=False),
    sorted_text("name"),
    sorted_text("name_key"),
    sa.Column("metadata", JSONB, nullable=False),
    # The submitted document, unchanged, with comments.
    sa.Column("metadata_yaml", sa.Text),
    sa.Column("metadata_problems", JSONB, nullable=False, server_default="[]"),
    sa.Column("notes", sa.Text, nullable=False, server_default=""),
    sa.Column("completed_at", sa.DateTime(timezone=True)),
    sa.Column("start_ns", sa.BigInteger),
    sa.Column("end_ns", sa.BigInteger),
    # Number of changes of the files or their content, and the number up to which recordings were derived.
    sa.Column("files_revision", sa.BigInteger, nullable=False, server_default="0"),
    sa.Column("derived_revision", sa.BigInteger, nullable=False, server_default="0"),
    # Sums over its files and recordings as of `derived_revision`. When files change, a trigger sets `file_count` to
    # null.
    sa.Column("file_count", sa.Integer),
    sa.Column("size_bytes", sa.Numeric),
    sa.Column("message_count", sa.Numeric),
    # Files that are not read yet, or whose recording will be read by the verification.
    sa.Column("unread_count", sa.Integer),
    sa.Column("duration_ns", sa.Numeric),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.Column("deleted_at", sa.DateTime(timezone=True)),
    sa.Column("deleted_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    sa.CheckConstraint("char_length(name) BETWEEN 1 AND 128", name="name_length"),
    sa.CheckConstraint("jsonb_typeof(metadata) = 'object'", name="metadata"),
    sa.CheckConstraint("(start_ns IS NULL) = (end_ns IS NULL) AND start_ns <= end_ns", name="span"),
    sa.CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name="deleted"),
    # With ids, for index-only scans when visible missions are counted.
    sa.Index(
        "uq_mission_name_key_live",
        "project_id",
        "name_key",
        unique=True,
        postgresql_where=sa.text("deleted_at IS NULL"),
        postgresql_include=["id"],
    ),
    # For index-only scans when the visible missions are summed up.
    sa.Index(
        "ix_mission_amounts",
        "project_id",
        postgresql_where=sa.text("deleted_at IS NULL"),
        postgresql_include=["id", "file_count", "size_bytes", "duration_ns"],
    ),
    sa.Index("ix_mission_name", "name", "id"),
    sa.Index("ix_mission_created_at", "created_at", "id"),
    # The order of missions in search results: latest first, missions without a time last.
    sa.Index("ix_mission_start_order", sa.text("coalesce(start_ns, '-9223372036854775808'::bigint)"), "id"),
    sa.Index("ix_mission_start_ns", "start_ns", "id"),
    sa.Index("ix_mission_metadata", "metadata", postgresql_using="gin", postgresql_ops={"metadata": "jsonb_path_ops"}),
    # For words of searches.
    sa.Index("ix_mission_name_words", "name_key", postgresql_using="gin", postgresql_ops={"name_key": "gin_trgm_ops"}),
    sa.Index("ix_mission_note_words", "notes", postgresql_using="gin", postgresql_ops={"notes": "gin_trgm_ops"}),
)

# The text contains the keys too, so matches are checked again.
sa.Index(
    "ix_mission_metadata_words",
    sa.cast(mission.c.metadata, sa.Text).label("as_text"),
    postgresql_using="gin",
    postgresql_ops={"as_text": "gin_trgm_ops"},
)


MAX_STORED_TOPICS = 20_000
"""Of one mission; the first ones by name."""

mission_topics = sa.Table(
    "mission_topics",
    metadata,
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True),
    # The mission's `files_revision` from which they were derived.
    sa.Column("revision", sa.BigInteger, nullable=False),
    # The recordings in order of time; topics refer to them by index.
    sa.Column("recording_ids", sa.ARRAY(sa.Uuid), nullable=False),
    # Width of the widest bins.
    sa.Column("bin_ns", sa.BigInteger, nullable=False),
)

mission_topic = sa.Table(
    "mission_topic",
    metadata,
    sa.Column("id", sa.BigInteger, sa.Identity(always=True), primary_key=True),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission_topics.mission_id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    sa.Column("message_type", sa.Text(collation="C")),
    sa.Column("count", sa.BigInteger),
    sa.Column("file_count", sa.Integer, nullable=False),
    sa.Column("recording_count", sa.Integer, nullable=False),
    # Ranges of indexes into `recording_ids`, as pairs of first and last, both inclusive.
    sa.Column("recording_ranges", sa.ARRAY(sa.Integer), nullable=False),
    sa.Column("first_ns", sa.BigInteger),
    sa.Column("last_ns", sa.BigInteger),
    sa.Column("rate_hz", sa.Double),
    sa.Column("longest_gap_ns", sa.BigInteger),
    sa.Column("stored_bytes", sa.BigInteger),
    # As written by `recordings.message_density.pack`.
    sa.Column("density", sa.LargeBinary),
    sa.UniqueConstraint("mission_id", "name", "message_type", postgresql_nulls_not_distinct=True),
)


recording = sa.Table(
    "recording",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    # Mission-relative: the folder of a rosbag2 recording, the file or stem of others.
    sorted_text("name"),
    sa.Column("kind", sa.Text, nullable=False),
    sa.Column("missing", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    sa.Column("unlisted", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    sa.Column("problems", JSONB, nullable=False, server_default="[]"),
    sa.Column("message_count", sa.BigInteger),
    sa.Column("start_ns", sa.BigInteger),
    sa.Column("end_ns", sa.BigInteger),
    sa.Column("content", sa.Text, nullable=False, server_default=ContentState.pending.value),
    sa.Column("content_reason", sa.Text),
    sa.Column("lost", JSONB(none_as_null=True)),
    # Made of files that runs made; not part of the mission's span and sums.
    sa.Column("is_derived", sa.Boolean, nullable=False, server_default=sa.text("false")),
    sa.UniqueConstraint("mission_id", "name", "kind", "is_derived"),
    one_of("content", ContentState),
    sa.CheckConstraint("start_ns <= end_ns", name="span"),
)

DERIVED_ORIGIN = "run"
"""Of a `file` that a run made from others of its mission. It is in no sum of what was recorded."""

file = sa.Table(
    "file",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id"), nullable=False),
    # A recording is derived from its files; deleting it never deletes a file.
    sa.Column("recording_id", sa.Uuid, sa.ForeignKey("recording.id", ondelete="SET NULL"), index=True),
    sa.Column("blob_id", sa.Uuid, sa.ForeignKey("blob.id"), nullable=False, index=True),
    # Copied from its blob by triggers.
    sa.Column("start_ns", sa.BigInteger),
    # The first position of its recording, copied from the preview of its blob by triggers.
    sa.Column("latitude", sa.Double),
    sa.Column("longitude", sa.Double),
    sorted_text("path"),
    sorted_text("path_key"),
    sa.Column("origin", sa.Text, nullable=False),
    sa.Column("uploaded_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.Column("labels", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    created_at_column(),
    sa.Column("deleted_at", sa.DateTime(timezone=True)),
    sa.Column("deleted_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    sa.CheckConstraint("char_length(path) BETWEEN 1 AND 1024", name="path_length"),
    sa.CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name="deleted"),
    sa.CheckConstraint("origin IN ('upload', 'link', 'run')", name="origin"),
    sa.Index(
        "uq_file_path_key_live", "mission_id", "path_key", unique=True, postgresql_where=sa.text("deleted_at IS NULL")
    ),
    sa.Index("ix_file_path", "mission_id", "path", "id"),
    sa.Index("ix_file_created_at", "created_at", "id"),
    # The order of files in search results: latest first, files without a time last. Includes the columns that decide
    # whether a file is shown.
    sa.Index(
        "ix_file_start_order",
        sa.text("coalesce(start_ns, '-9223372036854775808'::bigint)"),
        "id",
        postgresql_where=sa.text("deleted_at IS NULL"),
        postgresql_include=["start_ns", "blob_id", "mission_id"],
    ),
    # For the first position of a mission.
    sa.Index(
        "ix_file_position",
        "mission_id",
        "start_ns",
        "id",
        postgresql_where=sa.text("latitude IS NOT NULL AND deleted_at IS NULL AND origin <> 'run'"),
        postgresql_include=["latitude", "longitude"],
    ),
    sa.Index("ix_file_deleted_at", "deleted_at", postgresql_where=sa.text("deleted_at IS NOT NULL")),
    sa.Index("ix_file_labels", "labels", postgresql_using="gin"),
    # For words of searches. Two indexes: one suffices to know whether any path of a file with a time has a word.
    sa.Index(
        "ix_file_words_timed",
        "path_key",
        postgresql_using="gin",
        postgresql_ops={"path_key": "gin_trgm_ops"},
        postgresql_where=sa.text("start_ns IS NOT NULL"),
    ),
    sa.Index(
        "ix_file_words_untimed",
        "path_key",
        postgresql_using="gin",
        postgresql_ops={"path_key": "gin_trgm_ops"},
        postgresql_where=sa.text("start_ns IS NULL"),
    ),
)

sa.Index(
    "ix_file_label_words",
    sa.func.joined(file.c.labels).label("joined"),
    postgresql_using="gin",
    postgresql_ops={"joined": "gin_trgm_ops"},
)
