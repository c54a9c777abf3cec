"""People and the tokens they carry. Sign-in and rights come later; today there is one local owner."""

from sqlalchemy import CheckConstraint, Column, DateTime, ForeignKey, LargeBinary, Table, Text, Uuid

from kleinkram.server.tables.base import created_at_column, id_column, metadata

person = Table(
    "person",
    metadata,
    id_column(),
    Column("name", Text, nullable=False),
    created_at_column(),
)

# Only the SHA-256 of a token is kept: it has 256 random bits, so nothing slower is needed.
token = Table(
    "token",
    metadata,
    id_column(),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False, index=True),
    Column("name", Text, nullable=False),
    Column("secret_sha256", LargeBinary, nullable=False, unique=True),
    created_at_column(),
    Column("revoked_at", DateTime(timezone=True)),
    CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
)
