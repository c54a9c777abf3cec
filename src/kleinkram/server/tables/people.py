"""People, their addresses, sessions and tokens; groups and what these are granted; links for people without an account.

Every right is a grant to a group. Of a secret only its SHA-256 is stored: it has 256 random bits, so nothing slower is
needed.
"""

from sqlalchemy import (
    ARRAY,
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Index,
    LargeBinary,
    PrimaryKeyConstraint,
    SmallInteger,
    Table,
    Text,
    Uuid,
    text,
)

from kleinkram.contract.access import GroupKind, Right, Scope, TokenKind
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
    # A token of a run is valid while the run lasts, for at most `max_right`; the audit log may name it afterwards.
    Column("run_id", Uuid, ForeignKey("run.id", ondelete="SET NULL"), index=True),
    Column("max_right", Text),
    # A runner's: the one runner that may use it, null until the first one does. With `runner_labels`, that runner gets
    # only runs that ask for one of them.
    Column("runner_id", Uuid),
    Column("runner_labels", ARRAY(Text)),
    CheckConstraint("kind = 'runner' OR (runner_id IS NULL AND runner_labels IS NULL)", name="runner"),
    Index("ix_token_runner_id", "runner_id", postgresql_where=text("runner_id IS NOT NULL")),
    CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
    CheckConstraint("(run_id IS NULL OR kind = 'run') AND (kind = 'run') = (max_right IS NOT NULL)", name="run"),
    one_of("max_right", Right),
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


access_group = Table(
    "access_group",
    metadata,
    id_column(),
    Column("kind", Text, nullable=False),
    # Of a person's own group this is their name once more, of an e-mail's the address.
    sorted_text("name"),
    sorted_text("name_key"),
    Column("person_id", Uuid, ForeignKey("person.id"), unique=True),
    created_at_column(),
    Column("created_by_id", Uuid, ForeignKey("person.id")),
    one_of("kind", GroupKind),
    CheckConstraint("(kind = 'person') = (person_id IS NOT NULL)", name="person"),
    Index("uq_access_group_email", "name_key", unique=True, postgresql_where=text("kind = 'email'")),
    Index(
        "uq_access_group_name",
        "name_key",
        unique=True,
        postgresql_where=text("kind IN ('custom', 'affiliation', 'admins')"),
    ),
)

membership = Table(
    "membership",
    metadata,
    Column("group_id", Uuid, ForeignKey("access_group.id", ondelete="CASCADE"), nullable=False),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False),
    Column("is_editor", Boolean, nullable=False, server_default=text("false")),
    Column("expires_at", DateTime(timezone=True)),
    created_at_column(),
    Column("added_by_id", Uuid, ForeignKey("person.id")),
    PrimaryKeyConstraint("group_id", "person_id"),
    Index("ix_membership_person_id", "person_id", "group_id"),
)

# What the settings say of an affiliation group: what it gets on each new project, and who is in it. Members come and go
# with the exact domains of verified addresses; a group without a row here is one that the settings name no longer.
affiliation = Table(
    "affiliation",
    metadata,
    Column("group_id", Uuid, ForeignKey("access_group.id", ondelete="CASCADE"), primary_key=True),
    Column("default_level", SmallInteger),
    CheckConstraint("default_level BETWEEN 1 AND 4", name="default_level"),
)

affiliation_domain = Table(
    "affiliation_domain",
    metadata,
    sorted_text("domain", primary_key=True),
    Column("group_id", Uuid, ForeignKey("affiliation.group_id", ondelete="CASCADE"), primary_key=True),
)

_DECIDING = ["level", "expires_at"]
access_grant = Table(
    "access_grant",
    metadata,
    id_column(),
    Column("group_id", Uuid, ForeignKey("access_group.id", ondelete="CASCADE"), nullable=False),
    Column("project_id", Uuid, ForeignKey("project.id", ondelete="CASCADE")),
    Column("mission_id", Uuid, ForeignKey("mission.id", ondelete="CASCADE")),
    # The level of the contract's `Right`.
    Column("level", SmallInteger, nullable=False),
    Column("expires_at", DateTime(timezone=True)),
    created_at_column(),
    Column("granted_by_id", Uuid, ForeignKey("person.id")),
    CheckConstraint("num_nonnulls(project_id, mission_id) = 1", name="place"),
    CheckConstraint("level BETWEEN 1 AND 4", name="level"),
    # Rights are asked for with every list: all of a grant that decides stands in the index itself.
    Index("uq_access_grant_project", "project_id", "group_id", unique=True, postgresql_include=_DECIDING),
    Index("uq_access_grant_mission", "mission_id", "group_id", unique=True, postgresql_include=_DECIDING),
    Index("ix_access_grant_group_id", "group_id", postgresql_include=["project_id", "mission_id", *_DECIDING]),
    # Those on projects are few, and those on missions may be thousands: neither are read for the other.
    Index(
        "ix_access_grant_projects",
        "group_id",
        postgresql_include=["project_id", *_DECIDING],
        postgresql_where=text("project_id IS NOT NULL"),
    ),
    Index(
        "ix_access_grant_missions",
        "group_id",
        postgresql_include=["mission_id", *_DECIDING],
        postgresql_where=text("mission_id IS NOT NULL"),
    ),
)


share = Table(
    "share",
    metadata,
    id_column(),
    Column("mission_id", Uuid, ForeignKey("mission.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("name", Text, nullable=False),
    # Without, `share_file` says which files there are for it.
    Column("is_whole_mission", Boolean, nullable=False),
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
