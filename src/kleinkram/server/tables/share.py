"""Links to a mission, or to some of its files, for people without an account. Only a secret's SHA-256 is kept."""

from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    LargeBinary,
    PrimaryKeyConstraint,
    Table,
    Text,
    Uuid,
)

from kleinkram.server.tables.base import created_at_column, id_column, metadata

share = Table(
    "share",
    metadata,
    id_column(),
    Column("mission_id", Uuid, ForeignKey("mission.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("name", Text, nullable=False),
    # Without, `share_file` says which files there are for it.
    Column("is_whole", Boolean, nullable=False),
    Column("prefix", Text, nullable=False),
    Column("secret_sha256", LargeBinary, nullable=False, unique=True),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    created_at_column(),
    Column("expires_at", DateTime(timezone=True), nullable=False),
    Column("revoked_at", DateTime(timezone=True)),
    Column("last_used_at", DateTime(timezone=True)),
    Column("download_count", BigInteger, nullable=False, server_default="0"),
    Column("download_bytes", BigInteger, nullable=False, server_default="0"),
    CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
)

share_file = Table(
    "share_file",
    metadata,
    Column("share_id", Uuid, ForeignKey("share.id", ondelete="CASCADE"), nullable=False),
    Column("file_id", Uuid, ForeignKey("file.id", ondelete="CASCADE"), nullable=False, index=True),
    PrimaryKeyConstraint("share_id", "file_id"),
)
