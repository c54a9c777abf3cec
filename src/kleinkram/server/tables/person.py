"""People, their addresses, the sessions of their browsers and the tokens they carry.

Of a secret only its SHA-256 is kept: it has 256 random bits, so nothing slower is needed.
"""

from sqlalchemy import (
    ARRAY,
    Boolean,
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

from kleinkram.contract.access import Right, Scope, TokenKind
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

person = Table(
    "person",
    metadata,
    id_column(),
    Column("name", Text, nullable=False),
    created_at_column(),
    # Whoever left: no session, token or sign-in is theirs any more; their name stays in the record.
    Column("deactivated_at", DateTime(timezone=True)),
)

# `verified_by` says whose word it is that the address is theirs: an issuer's URL, or the admin's who invited them.
person_email = Table(
    "person_email",
    metadata,
    sorted_text("email_key", primary_key=True),
    Column("email", Text, nullable=False),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False, index=True),
    Column("verified_at", DateTime(timezone=True)),
    Column("verified_by", Text),
    CheckConstraint("(verified_at IS NULL) = (verified_by IS NULL)", name="verified"),
)

session = Table(
    "session",
    metadata,
    id_column(),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False, index=True),
    Column("secret_sha256", LargeBinary, nullable=False, unique=True),
    # How they signed in: `password`, `link`, or the issuer's URL.
    Column("method", Text, nullable=False),
    Column("address", Text),
    Column("user_agent", Text),
    created_at_column(),
    Column("last_used_at", DateTime(timezone=True), nullable=False, server_default=text("now()")),
    Column("expires_at", DateTime(timezone=True), nullable=False),
    Column("revoked_at", DateTime(timezone=True)),
    # When its person last proved who they are, by password or provider; what is sensitive asks for it again.
    Column("authenticated_at", DateTime(timezone=True), nullable=False, server_default=text("now()")),
    CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
)

token = Table(
    "token",
    metadata,
    id_column(),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False, index=True),
    Column("kind", Text, nullable=False, server_default=TokenKind.personal.value),
    Column("name", Text, nullable=False),
    # The beginning of the secret, by which people recognise it.
    Column("prefix", Text, nullable=False, server_default=""),
    Column("secret_sha256", LargeBinary, nullable=False, unique=True),
    Column("scopes", ARRAY(Text), nullable=False),
    # Whether `token_limit` says all there is for it: without, it reaches whatever its person reaches.
    Column("is_limited", Boolean, nullable=False, server_default=text("false")),
    created_at_column(),
    Column("expires_at", DateTime(timezone=True)),
    Column("last_used_at", DateTime(timezone=True)),
    Column("revoked_at", DateTime(timezone=True)),
    # With which token it was made: it ends with that one. None where somebody was signed in by a browser.
    Column("made_by_token_id", Uuid, ForeignKey("token.id"), index=True),
    # A run's: good while that run lasts, and for no more than `most`; the record may speak of it when the run is gone.
    Column("run_id", Uuid, ForeignKey("run.id", ondelete="SET NULL"), index=True),
    Column("most", Text),
    # A runner's: the one runner that may use it, null until the first one does. With `runner_labels`, that runner gets
    # only runs that ask for one of them.
    Column("runner_id", Uuid),
    Column("runner_labels", ARRAY(Text)),
    CheckConstraint("kind = 'runner' OR (runner_id IS NULL AND runner_labels IS NULL)", name="runner"),
    Index("ix_token_runner_id", "runner_id", postgresql_where=text("runner_id IS NOT NULL")),
    CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
    CheckConstraint("(run_id IS NULL OR kind = 'run') AND (kind = 'run') = (most IS NOT NULL)", name="run"),
    one_of("most", Right),
    CheckConstraint(
        f"scopes <@ ARRAY[{', '.join(repr(scope.value) for scope in Scope)}]::text[]",
        name="scopes",
    ),
    one_of("kind", TokenKind),
)

# Rows go with what they name, and the token stays limited.
token_limit = Table(
    "token_limit",
    metadata,
    id_column(),
    Column("token_id", Uuid, ForeignKey("token.id", ondelete="CASCADE"), nullable=False),
    Column("project_id", Uuid, ForeignKey("project.id", ondelete="CASCADE")),
    Column("mission_id", Uuid, ForeignKey("mission.id", ondelete="CASCADE")),
    CheckConstraint("num_nonnulls(project_id, mission_id) = 1", name="place"),
    Index("ix_token_limit_token_id", "token_id"),
)
