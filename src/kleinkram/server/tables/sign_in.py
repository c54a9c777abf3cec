"""Sign-in: identities at providers, passwords, one-time codes, and logins in progress.

Random secrets are stored as SHA-256, passwords as argon2id. What a login in progress needs back (`nonce`,
`code_verifier`) is useless without the browser or the program that began it, and deleted within minutes.
"""

import enum

from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    Table,
    Text,
    UniqueConstraint,
    Uuid,
    text,
)

from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text


class CodePurpose(str, enum.Enum):
    """Purpose of a one-time code."""

    bootstrap = "bootstrap"  # to become the first admin of a new server
    owner = "owner"  # to sign in as the owner of `klein up`
    invitation = "invitation"  # to get an account
    reset = "reset"  # to choose a new password


class LoginKind(str, enum.Enum):
    """Flow of a program's sign-in: a redirect to the loopback address, or a code typed on another device."""

    loopback = "loopback"
    device = "device"


# One person = one account, under as many identities as providers vouch for them. `email` is as the provider told it.
# One that was unlinked stays as such: else the provider's word on its address would link it again by itself.
identity = Table(
    "identity",
    metadata,
    id_column(),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False, index=True),
    Column("issuer", Text, nullable=False),
    Column("subject", Text, nullable=False),
    Column("email", Text),
    created_at_column(),
    Column("last_used_at", DateTime(timezone=True), nullable=False, server_default=text("now()")),
    Column("unlinked_at", DateTime(timezone=True)),
    UniqueConstraint("issuer", "subject"),
)

password = Table(
    "password",
    metadata,
    Column("person_id", Uuid, ForeignKey("person.id"), primary_key=True),
    Column("hash", Text, nullable=False),
    Column("changed_at", DateTime(timezone=True), nullable=False, server_default=text("now()")),
    CheckConstraint("hash LIKE '$argon2id$%'", name="hash"),
)

# The second factor of local accounts (RFC 6238); in use once it is confirmed. `secret` is base32: to check a code takes
# it as it is. `last_step` is the time step of the last code that was taken: none is taken twice.
totp = Table(
    "totp",
    metadata,
    Column("person_id", Uuid, ForeignKey("person.id"), primary_key=True),
    Column("secret", Text, nullable=False),
    created_at_column(),
    Column("confirmed_at", DateTime(timezone=True)),
    Column("last_step", BigInteger, nullable=False, server_default="0"),
    # Wrong codes since the last right one: after some, codes are not looked at for a while.
    Column("failed_count", Integer, nullable=False, server_default="0"),
    Column("failed_at", DateTime(timezone=True)),
)

# What stands for a code where the device is lost; deleted by its use.
recovery_code = Table(
    "recovery_code",
    metadata,
    Column("secret_sha256", LargeBinary, primary_key=True),
    Column("person_id", Uuid, ForeignKey("totp.person_id", ondelete="CASCADE"), nullable=False, index=True),
    CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
)

one_time_code = Table(
    "one_time_code",
    metadata,
    id_column(),
    Column("purpose", Text, nullable=False),
    Column("secret_sha256", LargeBinary, nullable=False, unique=True),
    # Whose it is, where there is an account already; else who is invited.
    Column("person_id", Uuid, ForeignKey("person.id"), index=True),
    Column("email", Text),
    Column("name", Text),
    Column("created_by_id", Uuid, ForeignKey("person.id")),
    created_at_column(),
    Column("expires_at", DateTime(timezone=True), nullable=False),
    Column("used_at", DateTime(timezone=True)),
    one_of("purpose", CodePurpose),
    CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
    CheckConstraint("(purpose IN ('owner', 'reset')) = (person_id IS NOT NULL)", name="person"),
    CheckConstraint("(purpose = 'invitation') = (email IS NOT NULL)", name="email"),
)

# Between the way to a provider and the way back. `session_id`: of whom asks to link one more identity to themselves,
# or, where it `renews`, to prove once more who they are.
oidc_login = Table(
    "oidc_login",
    metadata,
    Column("state_sha256", LargeBinary, primary_key=True),
    Column("provider", Text, nullable=False),
    Column("nonce", Text, nullable=False),
    Column("code_verifier", Text, nullable=False),
    Column("browser_sha256", LargeBinary, nullable=False),
    Column("session_id", Uuid, ForeignKey("session.id")),
    Column("reauthenticates", Boolean, nullable=False, server_default=text("false")),
    Column("return_to", Text, nullable=False),
    created_at_column(),
    Column("expires_at", DateTime(timezone=True), nullable=False, index=True),
    CheckConstraint("octet_length(state_sha256) = 32 AND octet_length(browser_sha256) = 32", name="sha256"),
)

# A program that asks for a token. `secret_sha256` is of the code that it redeems.
login_request = Table(
    "login_request",
    metadata,
    id_column(),
    Column("kind", Text, nullable=False),
    Column("secret_sha256", LargeBinary, nullable=False, unique=True),
    sorted_text("label"),
    Column("address", Text),
    Column("user_code", Text),
    Column("code_challenge", Text),
    Column("port", Integer),
    created_at_column(),
    Column("expires_at", DateTime(timezone=True), nullable=False, index=True),
    Column("polled_at", DateTime(timezone=True)),
    Column("approved_at", DateTime(timezone=True)),
    Column("approved_by_id", Uuid, ForeignKey("person.id")),
    Column("approved_session_id", Uuid, ForeignKey("session.id")),
    Column("denied_at", DateTime(timezone=True)),
    Column("redeemed_at", DateTime(timezone=True)),
    one_of("kind", LoginKind),
    CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
    CheckConstraint("(kind = 'device') = (user_code IS NOT NULL)", name="user_code"),
    CheckConstraint("(kind = 'loopback') = (code_challenge IS NOT NULL AND port IS NOT NULL)", name="loopback"),
    CheckConstraint("(approved_at IS NULL) = (approved_by_id IS NULL)", name="approved"),
    CheckConstraint("approved_at IS NULL OR denied_at IS NULL", name="decided"),
    CheckConstraint("redeemed_at IS NULL OR approved_at IS NOT NULL", name="redeemed"),
    Index(
        "uq_login_request_user_code",
        "user_code",
        unique=True,
        postgresql_where=text("redeemed_at IS NULL AND denied_at IS NULL"),
    ),
)

# How often something was done under a key, by windows of time. Not logged: after a crash, counting begins anew.
rate_count = Table(
    "rate_count",
    metadata,
    sorted_text("key", primary_key=True),
    Column("window_start", DateTime(timezone=True), primary_key=True),
    Column("count", Integer, nullable=False),
    Index("ix_rate_count_window_start", "window_start"),
    prefixes=["UNLOGGED"],
)
