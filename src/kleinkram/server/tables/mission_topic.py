"""The topics of missions, all recordings together: derived from their files, so that a page need not add them up."""

from sqlalchemy import (
    ARRAY,
    BigInteger,
    Column,
    Double,
    ForeignKey,
    Identity,
    Integer,
    LargeBinary,
    Table,
    Text,
    UniqueConstraint,
    Uuid,
)

from kleinkram.server.tables.base import metadata, sorted_text

MOST_KEPT_TOPICS = 20_000
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
    # As `recordings.density.pack` writes it.
    Column("density", LargeBinary),
    UniqueConstraint("mission_id", "name", "message_type", postgresql_nulls_not_distinct=True),
)
