"""Tables of blobs (bytes in the store and their summary), uploads, and scrubs, which compare store and database.

Topics and content belong to the blob, so that linking a duplicate copies nothing. The parts of an upload are listed by
the store only: a second list could disagree.
"""

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.files import BlobState, ContentState, ReadDepth
from kleinkram.contract.uploads import ChecksumKind, UploadState
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

blob = sa.Table(
    "blob",
    metadata,
    id_column(),
    sa.Column("store_id", sa.Text, nullable=False, server_default="main"),
    sa.Column("key", sa.Text, nullable=False),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    # The checksum that the store verified; null if it can only verify parts.
    sa.Column("crc64nvme", sa.LargeBinary),
    # As claimed by the uploader until the blob is verified.
    sa.Column("sha256", sa.LargeBinary, nullable=False),
    sa.Column("md5", sa.LargeBinary),
    sa.Column("state", sa.Text, nullable=False, server_default=BlobState.stored.value),
    sa.Column("state_reason", sa.Text),
    sa.Column("verified_at", sa.DateTime(timezone=True)),
    # When it was found lost or corrupt.
    sa.Column("damaged_at", sa.DateTime(timezone=True)),
    sa.Column("uploaded_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    created_at_column(),
    # Set when nothing refers to it any more: it can no longer be linked, and its object is deleted next.
    sa.Column("marked_for_deletion_at", sa.DateTime(timezone=True)),
    sa.Column("content", sa.Text, nullable=False, server_default=ContentState.pending.value),
    sa.Column("content_reason", sa.Text),
    sa.Column("format", sa.Text),
    sa.Column("message_count", sa.BigInteger),
    sa.Column("start_ns", sa.BigInteger),
    sa.Column("end_ns", sa.BigInteger),
    sa.Column("compression", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    sa.Column("problems", JSONB, nullable=False, server_default="[]"),
    sa.Column("depth", sa.Text),
    sa.Column("lost", JSONB(none_as_null=True)),
    sa.Column("facts", JSONB, nullable=False, server_default="[]"),
    sa.Column("summarised_at", sa.DateTime(timezone=True)),
    sa.UniqueConstraint("store_id", "key"),
    one_of("state", BlobState),
    one_of("content", ContentState),
    one_of("depth", ReadDepth),
    sa.CheckConstraint("size_bytes >= 0", name="size_bytes"),
    sa.CheckConstraint("octet_length(sha256) = 32", name="sha256"),
    sa.CheckConstraint("octet_length(md5) = 16", name="md5"),
    sa.CheckConstraint("octet_length(crc64nvme) = 8", name="crc64nvme"),
    sa.CheckConstraint("state <> 'verified' OR (md5 IS NOT NULL AND verified_at IS NOT NULL)", name="verified"),
    sa.CheckConstraint("start_ns <= end_ns", name="span"),
    # To find duplicates: by size before the hash is known, by hash afterwards.
    sa.Index("ix_blob_size_sha256", "size_bytes", "sha256", postgresql_where=sa.text("marked_for_deletion_at IS NULL")),
    sa.Index(
        "ix_blob_unverified",
        "created_at",
        postgresql_where=sa.text("state = 'stored' AND marked_for_deletion_at IS NULL"),
    ),
    # In the order in which a store lists objects.
    sa.Index("ix_blob_key", "store_id", "key", postgresql_ops={"key": "text_pattern_ops"}),
    # To find the blobs that were verified longest ago.
    sa.Index(
        "ix_blob_verified_at",
        "verified_at",
        postgresql_where=sa.text("state = 'verified' AND marked_for_deletion_at IS NULL"),
    ),
    # For the damaged files on the home page.
    sa.Index(
        "ix_blob_damaged",
        "id",
        postgresql_where=sa.text("state IN ('corrupt', 'lost') OR content IN ('broken', 'recovered', 'error')"),
    ),
    # The longest duration limits how early a recording that overlaps a time can start.
    sa.Index("ix_blob_duration", sa.text("(end_ns::numeric - start_ns::numeric)")),
    sa.Index(
        "ix_blob_marked_for_deletion",
        "marked_for_deletion_at",
        postgresql_where=sa.text("marked_for_deletion_at IS NOT NULL"),
    ),
)

topic = sa.Table(
    "topic",
    metadata,
    sa.Column("id", sa.BigInteger, sa.Identity(always=True), primary_key=True),
    sa.Column("blob_id", sa.Uuid, sa.ForeignKey("blob.id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    sa.Column("message_type", sa.Text(collation="C")),
    sa.Column("schema_name", sa.Text),
    sa.Column("schema_encoding", sa.Text),
    sa.Column("message_encoding", sa.Text),
    sa.Column("count", sa.BigInteger),
    sa.Column("first_ns", sa.BigInteger),
    sa.Column("last_ns", sa.BigInteger),
    sa.Column("rate_hz", sa.Double),
    sa.Column("longest_gap_ns", sa.BigInteger),
    sa.Column("head_gap_ns", sa.BigInteger),
    sa.Column("tail_gap_ns", sa.BigInteger),
    sa.Column("out_of_order_count", sa.BigInteger),
    sa.Column("stored_bytes", sa.BigInteger),
    # As written by `recordings.message_density.pack`; null if it was read before densities were stored.
    sa.Column("density", sa.LargeBinary),
    sa.UniqueConstraint("blob_id", "name", "message_type", postgresql_nulls_not_distinct=True),
    sa.Index("ix_topic_name", "name", "blob_id"),
    sa.Index("ix_topic_message_type", "message_type", "blob_id"),
)

# Previews of recordings: derived objects, which are in no backup and are made again.
recording_preview = sa.Table(
    "recording_preview",
    metadata,
    sa.Column("blob_id", sa.Uuid, sa.ForeignKey("blob.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("store_id", sa.Text, nullable=False, server_default="main"),
    # Of its object, from before it is written until after it is deleted.
    sa.Column("key", sa.Text),
    sa.Column("state", sa.Text, nullable=False),
    # The version of its contents; an earlier one is made again.
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("size_bytes", sa.BigInteger),
    # A small JPEG for lists, if a camera was recorded.
    sa.Column("thumbnail", sa.LargeBinary),
    # Whether it was searched for a position: earlier previews were not.
    sa.Column("is_position_known", sa.Boolean, nullable=False, server_default=sa.false()),
    # The first position that the recording has, in degrees (WGS 84); null without any.
    sa.Column("latitude", sa.Double),
    sa.Column("longitude", sa.Double),
    sa.Column("reason", sa.Text),
    # In succession, for want of time, memory or the store: after the first one, it is made once more.
    sa.Column("temporary_failures", sa.Integer, nullable=False, server_default="0"),
    sa.Column("made_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    sa.UniqueConstraint("store_id", "key"),
    sa.CheckConstraint("state IN ('making', 'ready', 'failed', 'deleted')", name="state"),
    sa.CheckConstraint("state <> 'ready' OR (key IS NOT NULL AND size_bytes IS NOT NULL)", name="ready"),
    sa.CheckConstraint("octet_length(thumbnail) <= 32768", name="thumbnail"),
    # NaN is greater than every number.
    sa.CheckConstraint(
        "(latitude IS NULL) = (longitude IS NULL) AND latitude BETWEEN -90 AND 90 AND longitude BETWEEN -180 AND 180",
        name="position",
    ),
    # To find the objects to be deleted.
    sa.Index(
        "ix_recording_preview_deleted",
        "blob_id",
        postgresql_where=sa.text("state IN ('deleted', 'failed') AND key IS NOT NULL"),
    ),
)

# All topic names, each once, to find the names that contain a word. A trigger maintains it.
topic_name = sa.Table(
    "topic_name",
    metadata,
    sorted_text("name", primary_key=True),
    sa.Index("ix_topic_name_words", "name", postgresql_using="gin", postgresql_ops={"name": "gin_trgm_ops"}),
)


# The states in which an upload reserves its name and counts toward the quota.
UNDER_WAY = (UploadState.open.value, UploadState.completing.value)

upload = sa.Table(
    "upload",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id"), nullable=False),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    # For a run's artifact, whose path is unique in the run; null for a future file of the mission.
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id"), index=True),
    sorted_text("path"),
    sorted_text("path_key"),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    sa.Column("part_size_bytes", sa.BigInteger, nullable=False),
    sa.Column("checksum", sa.Text, nullable=False),
    sa.Column("store_id", sa.Text, nullable=False, server_default="main"),
    sa.Column("key", sa.Text, nullable=False, unique=True),
    # The store's id of a multipart upload; null for a file of one part, which is a plain PUT.
    sa.Column("multipart_id", sa.Text),
    # For a file of one part: the only checksum for which its URL was signed, so the object has this checksum.
    sa.Column("signed_checksum", sa.Text),
    sa.Column("state", sa.Text, nullable=False, server_default=UploadState.open.value),
    sa.Column("sha256", sa.LargeBinary),
    sa.Column("crc64nvme", sa.LargeBinary),
    sa.Column("file_id", sa.Uuid, sa.ForeignKey("file.id", ondelete="SET NULL")),
    # Why an upload failed: the problem document for its client.
    sa.Column("failure", sa.Text),
    created_at_column(),
    # When parts were last signed: its client is active.
    sa.Column("renewed_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    # Until when it reserves the name; renewed whenever parts are signed.
    sa.Column("lease_ends_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("completing_since", sa.DateTime(timezone=True)),
    # When everything that this upload left in the store was deleted.
    sa.Column("cleaned_at", sa.DateTime(timezone=True)),
    one_of("state", UploadState),
    one_of("checksum", ChecksumKind),
    sa.CheckConstraint("size_bytes >= 0 AND part_size_bytes > 0", name="sizes"),
    sa.CheckConstraint(
        "state <> 'completing' OR (sha256 IS NOT NULL AND crc64nvme IS NOT NULL AND completing_since IS NOT NULL)",
        name="completing",
    ),
    # One upload at a time reserves a name; whether the file's name is free is decided at completion.
    sa.Index(
        "uq_upload_path_key_active",
        "mission_id",
        "path_key",
        unique=True,
        postgresql_where=sa.text("state IN ('open', 'completing') AND run_id IS NULL"),
    ),
    sa.Index(
        "uq_upload_run_path_active",
        "run_id",
        "path",
        unique=True,
        postgresql_where=sa.text("state IN ('open', 'completing') AND run_id IS NOT NULL"),
    ),
    sa.Index("ix_upload_expires_at", "expires_at", postgresql_where=sa.text("state IN ('open', 'completing')")),
    sa.Index("ix_upload_renewed_at", "renewed_at", postgresql_where=sa.text("state = 'open'")),
    # To find the rows that refer to a file or mission that is deleted.
    sa.Index("ix_upload_file_id", "file_id", postgresql_where=sa.text("file_id IS NOT NULL")),
    sa.Index("ix_upload_mission_id", "mission_id"),
    sa.Index("ix_upload_uncleaned", "created_at", postgresql_where=sa.text("cleaned_at IS NULL")),
)


def _count(name: str) -> sa.Column[int]:
    return sa.Column(name, sa.BigInteger, nullable=False, server_default="0")


scrub = sa.Table(
    "scrub",
    metadata,
    id_column(),
    sa.Column("store_id", sa.Text, nullable=False),
    # Null if it was scheduled.
    sa.Column("requested_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    # The person who requested it confirmed that this many objects are missing.
    sa.Column("accept_losses", sa.Boolean, nullable=False, server_default=sa.false()),
    created_at_column(),
    sa.Column("started_at", sa.DateTime(timezone=True)),
    # Heartbeat: another worker resumes the scrub if this is old.
    sa.Column("seen_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    sa.Column("ended_at", sa.DateTime(timezone=True)),
    # Why it stopped and marked nothing; null if it was completed.
    sa.Column("aborted_reason", sa.Text),
    _count("compared"),
    _count("compared_bytes"),
    _count("lost"),
    _count("corrupt"),
    _count("recovered"),
    _count("unknown"),
    sa.CheckConstraint("aborted_reason IS NULL OR ended_at IS NOT NULL", name="aborted"),
    sa.Index("ix_scrub_created_at", "store_id", "created_at"),
)


store_probe = sa.Table(
    "store_probe",
    metadata,
    sa.Column("store_id", sa.Text, primary_key=True),
    sa.Column("checksum", sa.Text, nullable=False),
    sa.Column("writes_once", sa.Boolean, nullable=False),
    sa.Column("probed_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    one_of("checksum", ChecksumKind),
)
