"""Uploads under way. The store holds the parts and is asked for them; a list of ours could only disagree."""

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Index,
    LargeBinary,
    Table,
    Text,
    Uuid,
    text,
)

from kleinkram.contract.uploads import ChecksumKind, UploadState
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

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
