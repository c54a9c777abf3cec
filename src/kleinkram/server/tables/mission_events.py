"""The table of mission events: moments and spans that people, programs and runs mark."""

import sqlalchemy as sa

from kleinkram.contract.mission_events import EventReference
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

mission_event = sa.Table(
    "mission_event",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    sorted_text("name_key"),
    sa.Column("start_ns", sa.BigInteger, nullable=False),
    sa.Column("end_ns", sa.BigInteger),
    sa.Column("labels", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    sa.Column("colour", sa.Text),
    sa.Column("note", sa.Text, nullable=False, server_default=""),
    # Stays when the file is purged, or the recording is derived again with another name: the event is then of nothing.
    sa.Column("refers_to", sa.Text, nullable=False, server_default=EventReference.mission.value),
    sa.Column("file_id", sa.Uuid, sa.ForeignKey("file.id", ondelete="SET NULL"), index=True),
    sa.Column("recording_id", sa.Uuid, sa.ForeignKey("recording.id", ondelete="SET NULL"), index=True),
    sa.Column("topic", sa.Text(collation="C")),
    # The run that added it, or that reported the finding.
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="SET NULL"), index=True),
    sa.Column("finding_id", sa.BigInteger, sa.ForeignKey("run_finding.id", ondelete="SET NULL")),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.CheckConstraint("char_length(name) BETWEEN 1 AND 128", name="name_length"),
    sa.CheckConstraint("start_ns >= 0 AND end_ns >= start_ns", name="span"),
    sa.CheckConstraint("colour ~ '^#[0-9a-f]{6}$'", name="colour"),
    sa.CheckConstraint("char_length(note) <= 10000", name="note_length"),
    sa.CheckConstraint("cardinality(labels) <= 20", name="label_count"),
    sa.CheckConstraint("char_length(topic) BETWEEN 1 AND 1024", name="topic_length"),
    one_of("refers_to", EventReference),
    sa.CheckConstraint("refers_to = 'file' OR file_id IS NULL", name="file"),
    sa.CheckConstraint("refers_to = 'recording' OR recording_id IS NULL", name="recording"),
    # Once for each finding; also finds the event when its finding is deleted.
    sa.UniqueConstraint("finding_id"),
    sa.Index("ix_mission_event_mission_start", "mission_id", "start_ns", "id"),
    sa.Index("ix_mission_event_start_ns", "start_ns", "id"),
    sa.Index("ix_mission_event_created_at", "created_at", "id"),
    sa.Index("ix_mission_event_created_by_id", "created_by_id"),
    # For searches: a name or the beginning of one, and other globs.
    sa.Index("ix_mission_event_name_key", "name_key", "mission_id"),
    sa.Index(
        "ix_mission_event_name_words", "name_key", postgresql_using="gin", postgresql_ops={"name_key": "gin_trgm_ops"}
    ),
)
