"""Blobs: bytes in a store, with what is known of them. Topics and content hang here, so that links cost nothing."""

from sqlalchemy import (
    ARRAY,
    BigInteger,
    CheckConstraint,
    Column,
    DateTime,
    Double,
    ForeignKey,
    Identity,
    Index,
    LargeBinary,
    Table,
    Text,
    UniqueConstraint,
    Uuid,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.files import BlobState, ContentState, ReadDepth
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

blob = Table(
    "blob",
    metadata,
    id_column(),
    Column("store_id", Text, nullable=False, server_default="main"),
    Column("key", Text, nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    # What the store itself verified; null where it can only verify parts.
    Column("crc64nvme", LargeBinary),
    # The uploader's word until the blob is verified.
    Column("sha256", LargeBinary, nullable=False),
    Column("md5", LargeBinary),
    Column("state", Text, nullable=False, server_default=BlobState.stored.value),
    Column("state_reason", Text),
    Column("verified_at", DateTime(timezone=True)),
    # Since when it is lost or corrupt.
    Column("damaged_at", DateTime(timezone=True)),
    Column("uploaded_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    created_at_column(),
    # Set when nothing refers to it any more: from then on it can no longer be linked, and its object goes next.
    Column("doomed_at", DateTime(timezone=True)),
    Column("content", Text, nullable=False, server_default=ContentState.pending.value),
    Column("content_reason", Text),
    Column("format", Text),
    Column("message_count", BigInteger),
    Column("start_ns", BigInteger),
    Column("end_ns", BigInteger),
    Column("compression", ARRAY(Text), nullable=False, server_default="{}"),
    Column("problems", JSONB, nullable=False, server_default="[]"),
    Column("depth", Text),
    Column("lost", JSONB(none_as_null=True)),
    Column("facts", JSONB, nullable=False, server_default="[]"),
    Column("summarised_at", DateTime(timezone=True)),
    UniqueConstraint("store_id", "key"),
    one_of("state", BlobState),
    one_of("content", ContentState),
    one_of("depth", ReadDepth),
    CheckConstraint("size_bytes >= 0", name="size_bytes"),
    CheckConstraint("octet_length(sha256) = 32", name="sha256"),
    CheckConstraint("octet_length(md5) = 16", name="md5"),
    CheckConstraint("octet_length(crc64nvme) = 8", name="crc64nvme"),
    CheckConstraint("state <> 'verified' OR (md5 IS NOT NULL AND verified_at IS NOT NULL)", name="verified"),
    CheckConstraint("start_ns <= end_ns", name="span"),
    # Finding a twin: by size before the hash is known, by hash after.
    Index("ix_blob_size_sha256", "size_bytes", "sha256", postgresql_where=text("doomed_at IS NULL")),
    Index("ix_blob_unverified", "created_at", postgresql_where=text("state = 'stored' AND doomed_at IS NULL")),
    # As a store lists them.
    Index("ix_blob_key", "store_id", "key", postgresql_ops={"key": "text_pattern_ops"}),
    # Finds the blobs that were verified longest ago.
    Index("ix_blob_verified_at", "verified_at", postgresql_where=text("state = 'verified' AND doomed_at IS NULL")),
    # What home lists of all files that somebody sees.
    Index(
        "ix_blob_ailing",
        "id",
        postgresql_where=text("state IN ('corrupt', 'lost') OR content IN ('broken', 'recovered', 'error')"),
    ),
    # How long the longest lasts bounds where one begins that was under way at some time.
    Index("ix_blob_duration", text("(end_ns::numeric - start_ns::numeric)")),
    Index("ix_blob_doomed", "doomed_at", postgresql_where=text("doomed_at IS NOT NULL")),
)

topic = Table(
    "topic",
    metadata,
    Column("id", BigInteger, Identity(always=True), primary_key=True),
    Column("blob_id", Uuid, ForeignKey("blob.id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    Column("message_type", Text(collation="C")),
    Column("schema_name", Text),
    Column("schema_encoding", Text),
    Column("message_encoding", Text),
    Column("count", BigInteger),
    Column("first_ns", BigInteger),
    Column("last_ns", BigInteger),
    Column("rate_hz", Double),
    Column("longest_gap_ns", BigInteger),
    Column("head_gap_ns", BigInteger),
    Column("tail_gap_ns", BigInteger),
    Column("out_of_order_count", BigInteger),
    Column("stored_bytes", BigInteger),
    # As `recordings.density.pack` writes it; null where it was read before densities were kept.
    Column("density", LargeBinary),
    UniqueConstraint("blob_id", "name", "message_type", postgresql_nulls_not_distinct=True),
    Index("ix_topic_name", "name", "blob_id"),
    Index("ix_topic_message_type", "message_type", "blob_id"),
)

# The names of all topics there were, each once: in which of them a word stands is soon known. A trigger keeps it.
topic_name = Table(
    "topic_name",
    metadata,
    sorted_text("name", primary_key=True),
    Index("ix_topic_name_words", "name", postgresql_using="gin", postgresql_ops={"name": "gin_trgm_ops"}),
)
