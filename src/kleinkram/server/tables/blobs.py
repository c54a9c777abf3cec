"""Blobs (bytes in a store, with what is known of them), uploads, and comparisons of the store with the database.

Topics and content belong to the blob, so that linking costs nothing. The store is asked for the parts of an upload: a
list here could only disagree.
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
    LargeBinary,
    Table,
    Text,
    UniqueConstraint,
    Uuid,
    false,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.files import BlobState, ContentState, ReadDepth
from kleinkram.contract.uploads import ChecksumKind, UploadState
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
    Column("marked_for_deletion_at", DateTime(timezone=True)),
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
    Index("ix_blob_size_sha256", "size_bytes", "sha256", postgresql_where=text("marked_for_deletion_at IS NULL")),
    Index(
        "ix_blob_unverified", "created_at", postgresql_where=text("state = 'stored' AND marked_for_deletion_at IS NULL")
    ),
    # As a store lists them.
    Index("ix_blob_key", "store_id", "key", postgresql_ops={"key": "text_pattern_ops"}),
    # Finds the blobs that were verified longest ago.
    Index(
        "ix_blob_verified_at",
        "verified_at",
        postgresql_where=text("state = 'verified' AND marked_for_deletion_at IS NULL"),
    ),
    # What home lists of all files that somebody sees.
    Index(
        "ix_blob_ailing",
        "id",
        postgresql_where=text("state IN ('corrupt', 'lost') OR content IN ('broken', 'recovered', 'error')"),
    ),
    # How long the longest lasts bounds where one begins that was under way at some time.
    Index("ix_blob_duration", text("(end_ns::numeric - start_ns::numeric)")),
    Index(
        "ix_blob_marked_for_deletion",
        "marked_for_deletion_at",
        postgresql_where=text("marked_for_deletion_at IS NOT NULL"),
    ),
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
    # As `recordings.message_density.pack` writes it; null where it was read before densities were kept.
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


# The states in which an upload holds its name, and the room for its bytes.
UNDER_WAY = (UploadState.open.value, UploadState.completing.value)

upload = Table(
    "upload",
    metadata,
    id_column(),
    Column("mission_id", Uuid, ForeignKey("mission.id"), nullable=False),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False),
    # Of a run's artifact, whose path is one among those of the run; null where it becomes a file of the mission.
    Column("run_id", Uuid, ForeignKey("run.id"), index=True),
    sorted_text("path"),
    sorted_text("path_key"),
    Column("size_bytes", BigInteger, nullable=False),
    Column("part_size_bytes", BigInteger, nullable=False),
    Column("checksum", Text, nullable=False),
    Column("store_id", Text, nullable=False, server_default="main"),
    Column("key", Text, nullable=False, unique=True),
    # The store's name for a multipart upload; null for a file of one part, which is one plain PUT.
    Column("multipart_id", Text),
    # For a file of one part: the only checksum its address was ever signed for, so what arrived is what was named.
    Column("signed_checksum", Text),
    Column("state", Text, nullable=False, server_default=UploadState.open.value),
    Column("sha256", LargeBinary),
    Column("crc64nvme", LargeBinary),
    Column("file_id", Uuid, ForeignKey("file.id", ondelete="SET NULL")),
    # Why an upload ended other than well: the problem document its client is owed.
    Column("failure", Text),
    created_at_column(),
    # Who holds the name: renewed whenever parts are signed.
    Column("lease_ends_at", DateTime(timezone=True), nullable=False),
    Column("expires_at", DateTime(timezone=True), nullable=False),
    Column("completing_since", DateTime(timezone=True)),
    # Set once the store has been rid of whatever this upload left there.
    Column("cleaned_at", DateTime(timezone=True)),
    one_of("state", UploadState),
    one_of("checksum", ChecksumKind),
    CheckConstraint("size_bytes >= 0 AND part_size_bytes > 0", name="sizes"),
    CheckConstraint(
        "state <> 'completing' OR (sha256 IS NOT NULL AND crc64nvme IS NOT NULL AND completing_since IS NOT NULL)",
        name="completing",
    ),
    # One upload at a time holds a name; uniqueness of the file itself is decided at complete.
    Index(
        "uq_upload_path_key_active",
        "mission_id",
        "path_key",
        unique=True,
        postgresql_where=text("state IN ('open', 'completing') AND run_id IS NULL"),
    ),
    Index(
        "uq_upload_run_path_active",
        "run_id",
        "path",
        unique=True,
        postgresql_where=text("state IN ('open', 'completing') AND run_id IS NOT NULL"),
    ),
    Index("ix_upload_expires_at", "expires_at", postgresql_where=text("state IN ('open', 'completing')")),
    # For deleting a file or a mission: the rows that refer to it are found without reading all.
    Index("ix_upload_file_id", "file_id", postgresql_where=text("file_id IS NOT NULL")),
    Index("ix_upload_mission_id", "mission_id"),
    Index("ix_upload_uncleaned", "created_at", postgresql_where=text("cleaned_at IS NULL")),
)


def _count(name: str) -> "Column[int]":
    return Column(name, BigInteger, nullable=False, server_default="0")


scrub = Table(
    "scrub",
    metadata,
    id_column(),
    Column("store_id", Text, nullable=False),
    # Null where it was due by itself.
    Column("requested_by_id", Uuid, ForeignKey("person.id")),
    # Whoever asked has looked, and says that so many objects are gone indeed.
    Column("accept_losses", Boolean, nullable=False, server_default=false()),
    created_at_column(),
    Column("started_at", DateTime(timezone=True)),
    # When it was last at work: who finds it long ago takes it up again.
    Column("seen_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("ended_at", DateTime(timezone=True)),
    # Why it stopped and marked nothing; null where it went through.
    Column("aborted_reason", Text),
    _count("compared"),
    _count("compared_bytes"),
    _count("lost"),
    _count("corrupt"),
    _count("recovered"),
    _count("unknown"),
    CheckConstraint("aborted_reason IS NULL OR ended_at IS NOT NULL", name="aborted"),
    Index("ix_scrub_created_at", "store_id", "created_at"),
)


store_probe = Table(
    "store_probe",
    metadata,
    Column("store_id", Text, primary_key=True),
    Column("checksum", Text, nullable=False),
    Column("writes_once", Boolean, nullable=False),
    Column("probed_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    one_of("checksum", ChecksumKind),
)
