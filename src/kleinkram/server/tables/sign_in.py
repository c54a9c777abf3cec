"""Tables of sign-in: identities at providers, passwords, second factors, one-time codes, and logins in progress.

Random secrets are stored as SHA-256, passwords as argon2id. `nonce` and `code_verifier` of a login in progress are
stored in plain: they are useless without the browser or program that started it, and are deleted after some minutes.
Refresh tokens are stored in plain, too, since checking an account requires them: they are useless without the secret of
the client, and are deleted with the last session that depends on them.
"""

import enum

import sqlalchemy as sa

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


# A person has one account and any number of identities. `email` is the address that the provider sent. Unlinked
# identities are kept: otherwise they would be linked again automatically by their address.
identity = sa.Table(
    "identity",
    metadata,
    id_column(),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False, index=True),
    sa.Column("issuer", sa.Text, nullable=False),
    sa.Column("subject", sa.Text, nullable=False),
    sa.Column("email", sa.Text),
    created_at_column(),
    sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.text("now()")),
    sa.Column("unlinked_at", sa.DateTime(timezone=True)),
    # When the provider last confirmed that the account exists, by a sign-in or a refresh token.
    sa.Column("confirmed_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.text("now()")),
    # When the account was last checked; null to check it soon.
    sa.Column("checked_at", sa.DateTime(timezone=True)),
    sa.Column("refresh_token", sa.Text),
    sa.UniqueConstraint("issuer", "subject"),
)

password = sa.Table(
    "password",
    metadata,
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), primary_key=True),
    sa.Column("hash", sa.Text, nullable=False),
    sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.text("now()")),
    sa.CheckConstraint("hash LIKE '$argon2id$%'", name="hash"),
)

# The second factor of local accounts (RFC 6238), in use once it is confirmed. `secret` is base32 in plain, which
# checking a code requires. `last_step` is the time step of the last accepted code, so that no code is valid twice.
totp = sa.Table(
    "totp",
    metadata,
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), primary_key=True),
    sa.Column("secret", sa.Text, nullable=False),
    created_at_column(),
    sa.Column("confirmed_at", sa.DateTime(timezone=True)),
    sa.Column("last_step", sa.BigInteger, nullable=False, server_default="0"),
    # Wrong codes since the last correct one; too many cause a lockout.
    sa.Column("failed_count", sa.Integer, nullable=False, server_default="0"),
    sa.Column("failed_at", sa.DateTime(timezone=True)),
)

# One-time replacements for TOTP codes; deleted when used.
recovery_code = sa.Table(
    "recovery_code",
    metadata,
    sa.Column("secret_sha256", sa.LargeBinary, primary_key=True),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("totp.person_id", ondelete="CASCADE"), nullable=False, index=True),
    sa.CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
)

one_time_code = sa.Table(
    "one_time_code",
    metadata,
    id_column(),
    sa.Column("purpose", sa.Text, nullable=False),
    sa.Column("secret_sha256", sa.LargeBinary, nullable=False, unique=True),
    # The person, or for an invitation the invited address and name.
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), index=True),
    sa.Column("email", sa.Text),
    sa.Column("name", sa.Text),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    created_at_column(),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("used_at", sa.DateTime(timezone=True)),
    one_of("purpose", CodePurpose),
    sa.CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
    sa.CheckConstraint("(purpose IN ('owner', 'reset')) = (person_id IS NOT NULL)", name="person"),
    sa.CheckConstraint("(purpose = 'invitation') = (email IS NOT NULL)", name="email"),
)

# Authorization requests to a provider. `session_id`: the signed-in person links an identity to their account, or with
# `reauthenticates` signs in again.
oidc_login = sa.Table(
    "oidc_login",
    metadata,
    sa.Column("state_sha256", sa.LargeBinary, primary_key=True),
    sa.Column("provider", sa.Text, nullable=False),
    sa.Column("nonce", sa.Text, nullable=False),
    sa.Column("code_verifier", sa.Text, nullable=False),
    sa.Column("browser_sha256", sa.LargeBinary, nullable=False),
    sa.Column("session_id", sa.Uuid, sa.ForeignKey("session.id")),
    sa.Column("reauthenticates", sa.Boolean, nullable=False, server_default=sa.text("false")),
    sa.Column("return_to", sa.Text, nullable=False),
    created_at_column(),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False, index=True),
    sa.CheckConstraint("octet_length(state_sha256) = 32 AND octet_length(browser_sha256) = 32", name="sha256"),
)

# The ids of logout tokens, so that none is accepted twice (OpenID Connect Back-Channel Logout 1.0, section 2.6).
used_logout_token = sa.Table(
    "used_logout_token",
    metadata,
    sorted_text("issuer", primary_key=True),
    sorted_text("jti", primary_key=True),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False, index=True),
)

# Programs that request a token. `secret_sha256` is that of the code that they exchange.
login_request = sa.Table(
    "login_request",
    metadata,
    id_column(),
    sa.Column("kind", sa.Text, nullable=False),
    sa.Column("secret_sha256", sa.LargeBinary, nullable=False, unique=True),
    sorted_text("label"),
    sa.Column("address", sa.Text),
    sa.Column("user_code", sa.Text),
    sa.Column("code_challenge", sa.Text),
    sa.Column("port", sa.Integer),
    created_at_column(),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False, index=True),
    sa.Column("polled_at", sa.DateTime(timezone=True)),
    sa.Column("approved_at", sa.DateTime(timezone=True)),
    sa.Column("approved_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    sa.Column("approved_session_id", sa.Uuid, sa.ForeignKey("session.id")),
    sa.Column("denied_at", sa.DateTime(timezone=True)),
    sa.Column("redeemed_at", sa.DateTime(timezone=True)),
    one_of("kind", LoginKind),
    sa.CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
    sa.CheckConstraint("(kind = 'device') = (user_code IS NOT NULL)", name="user_code"),
    sa.CheckConstraint("(kind = 'loopback') = (code_challenge IS NOT NULL AND port IS NOT NULL)", name="loopback"),
    sa.CheckConstraint("(approved_at IS NULL) = (approved_by_id IS NULL)", name="approved"),
    sa.CheckConstraint("approved_at IS NULL OR denied_at IS NULL", name="decided"),
    sa.CheckConstraint("redeemed_at IS NULL OR approved_at IS NOT NULL", name="redeemed"),
    sa.Index(
        "uq_login_request_user_code",
        "user_code",
        unique=True,
        postgresql_where=sa.text("redeemed_at IS NULL AND denied_at IS NULL"),
    ),
)

# Counters of rate limits by key and time window. Unlogged: after a crash, counting restarts.
rate_count = sa.Table(
    "rate_count",
    metadata,
    sorted_text("key", primary_key=True),
    sa.Column("window_start", sa.DateTime(timezone=True), primary_key=True),
    sa.Column("count", sa.Integer, nullable=False),
    sa.Index("ix_rate_count_window_start", "window_start"),
    prefixes=["UNLOGGED"],
)
