"""Tables of people, erasures, e-mail addresses, sessions, tokens, groups, grants, and share links.

Every right is a grant to a group. Only the SHA-256 of a secret is stored, which suffices for 256 random bits.
"""

import sqlalchemy as sa

from kleinkram.contract.access import GroupKind, Right, Scope, TokenKind
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

person = sa.Table(
    "person",
    metadata,
    id_column(),
    sa.Column("name", sa.Text, nullable=False),
    created_at_column(),
    # A deactivated person has no valid session or token and cannot sign in; their name stays in the audit log.
    sa.Column("deactivated_at", sa.DateTime(timezone=True)),
    # The name of an erased person is a pseudonym; they stay deactivated.
    sa.Column("erased_at", sa.DateTime(timezone=True)),
    sa.CheckConstraint("erased_at IS NULL OR deactivated_at IS NOT NULL", name="erased"),
)

# What is to be replaced in the audit log for an erased person, until a job has done it in `event_count` events.
erasure = sa.Table(
    "erasure",
    metadata,
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), primary_key=True),
    sa.Column("names", sa.ARRAY(sa.Text)),
    sa.Column("addresses", sa.ARRAY(sa.Text)),
    sa.Column("finished_at", sa.DateTime(timezone=True)),
    sa.Column("event_count", sa.BigInteger),
    sa.CheckConstraint(
        "num_nulls(names, addresses) = 0 AND num_nonnulls(finished_at, event_count) = 0"
        " OR num_nulls(names, addresses) = 2 AND num_nonnulls(finished_at, event_count) = 2",
        name="finished",
    ),
)

# `verified_by`: what verified the address: the URL of an issuer, `invitation` or `bootstrap`.
person_email = sa.Table(
    "person_email",
    metadata,
    sorted_text("email_key", primary_key=True),
    sa.Column("email", sa.Text, nullable=False),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False, index=True),
    sa.Column("verified_at", sa.DateTime(timezone=True)),
    sa.Column("verified_by", sa.Text),
    sa.CheckConstraint("(verified_at IS NULL) = (verified_by IS NULL)", name="verified"),
)

session = sa.Table(
    "session",
    metadata,
    id_column(),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False, index=True),
    sa.Column("secret_sha256", sa.LargeBinary, nullable=False, unique=True),
    # How the person signed in: `password`, `link`, `bootstrap`, or the issuer's URL.
    sa.Column("method", sa.Text, nullable=False),
    # The account at a provider that started it, and the id of the session there, if the provider sent one.
    sa.Column("identity_id", sa.Uuid, sa.ForeignKey("identity.id", ondelete="SET NULL"), index=True),
    sa.Column("provider_session_id", sa.Text),
    sa.Column("address", sa.Text),
    sa.Column("user_agent", sa.Text),
    created_at_column(),
    sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.text("now()")),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("revoked_at", sa.DateTime(timezone=True)),
    # When the person last authenticated, by password or provider; sensitive operations require that to be recent.
    sa.Column("authenticated_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.text("now()")),
    sa.CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
)

token = sa.Table(
    "token",
    metadata,
    id_column(),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False, index=True),
    sa.Column("kind", sa.Text, nullable=False, server_default=TokenKind.personal.value),
    sa.Column("name", sa.Text, nullable=False),
    # The beginning of the secret, to recognise the token in lists.
    sa.Column("prefix", sa.Text, nullable=False, server_default=""),
    sa.Column("secret_sha256", sa.LargeBinary, nullable=False, unique=True),
    sa.Column("scopes", sa.ARRAY(sa.Text), nullable=False),
    # Whether the token is limited to the rows of `token_limit`; otherwise it has all rights of its person.
    sa.Column("is_limited", sa.Boolean, nullable=False, server_default=sa.text("false")),
    created_at_column(),
    sa.Column("expires_at", sa.DateTime(timezone=True)),
    sa.Column("last_used_at", sa.DateTime(timezone=True)),
    sa.Column("revoked_at", sa.DateTime(timezone=True)),
    # The token that created it, whose revocation revokes it too; null if a browser session created it.
    sa.Column("created_by_token_id", sa.Uuid, sa.ForeignKey("token.id"), index=True),
    # For tokens of `klein login`: the account at a provider with which the person signed in to approve it.
    sa.Column("identity_id", sa.Uuid, sa.ForeignKey("identity.id", ondelete="SET NULL"), index=True),
    # The token of a run is valid during the run, for at most `max_right`. The row stays for the audit log.
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="SET NULL"), index=True),
    sa.Column("max_right", sa.Text),
    # For tokens of runners: the only runner that may use it; null before its first use. With `runner_labels`, that
    # runner gets only runs that require one of them.
    sa.Column("runner_id", sa.Uuid),
    sa.Column("runner_labels", sa.ARRAY(sa.Text)),
    sa.CheckConstraint("kind = 'runner' OR (runner_id IS NULL AND runner_labels IS NULL)", name="runner"),
    sa.Index("ix_token_runner_id", "runner_id", postgresql_where=sa.text("runner_id IS NOT NULL")),
    sa.CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
    sa.CheckConstraint("(run_id IS NULL OR kind = 'run') AND (kind = 'run') = (max_right IS NOT NULL)", name="run"),
    one_of("max_right", Right),
    sa.CheckConstraint(
        f"scopes <@ ARRAY[{', '.join(repr(scope.value) for scope in Scope)}]::text[]",
        name="scopes",
    ),
    one_of("kind", TokenKind),
)

# Rows are deleted with their project or mission; the token stays limited.
token_limit = sa.Table(
    "token_limit",
    metadata,
    id_column(),
    sa.Column("token_id", sa.Uuid, sa.ForeignKey("token.id", ondelete="CASCADE"), nullable=False),
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id", ondelete="CASCADE")),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE")),
    sa.CheckConstraint("num_nonnulls(project_id, mission_id) = 1", name="resource"),
    sa.Index("ix_token_limit_token_id", "token_id"),
)


access_group = sa.Table(
    "access_group",
    metadata,
    id_column(),
    sa.Column("kind", sa.Text, nullable=False),
    # The name of the person for their own group, the address for the group of an address.
    sorted_text("name"),
    sorted_text("name_key"),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), unique=True),
    created_at_column(),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    one_of("kind", GroupKind),
    sa.CheckConstraint("(kind = 'person') = (person_id IS NOT NULL)", name="person"),
    sa.Index("uq_access_group_email", "name_key", unique=True, postgresql_where=sa.text("kind = 'email'")),
    sa.Index(
        "uq_access_group_name",
        "name_key",
        unique=True,
        postgresql_where=sa.text("kind IN ('custom', 'affiliation', 'admins')"),
    ),
)

membership = sa.Table(
    "membership",
    metadata,
    sa.Column("group_id", sa.Uuid, sa.ForeignKey("access_group.id", ondelete="CASCADE"), nullable=False),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.Column("is_editor", sa.Boolean, nullable=False, server_default=sa.text("false")),
    sa.Column("expires_at", sa.DateTime(timezone=True)),
    created_at_column(),
    sa.Column("added_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    sa.PrimaryKeyConstraint("group_id", "person_id"),
    sa.Index("ix_membership_person_id", "person_id", "group_id"),
)

# Affiliation groups in the settings, with their right on new projects and their domains. Their members have a verified
# address in exactly one of the domains. An affiliation group without a row has left the settings.
affiliation = sa.Table(
    "affiliation",
    metadata,
    sa.Column("group_id", sa.Uuid, sa.ForeignKey("access_group.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("default_level", sa.SmallInteger),
    sa.CheckConstraint("default_level BETWEEN 1 AND 4", name="default_level"),
)

affiliation_domain = sa.Table(
    "affiliation_domain",
    metadata,
    sorted_text("domain", primary_key=True),
    sa.Column("group_id", sa.Uuid, sa.ForeignKey("affiliation.group_id", ondelete="CASCADE"), primary_key=True),
)

_DECIDING = ["level", "expires_at"]
access_grant = sa.Table(
    "access_grant",
    metadata,
    id_column(),
    sa.Column("group_id", sa.Uuid, sa.ForeignKey("access_group.id", ondelete="CASCADE"), nullable=False),
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id", ondelete="CASCADE")),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE")),
    # Level of `Right` in the contract.
    sa.Column("level", sa.SmallInteger, nullable=False),
    sa.Column("expires_at", sa.DateTime(timezone=True)),
    created_at_column(),
    sa.Column("granted_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    sa.CheckConstraint("num_nonnulls(project_id, mission_id) = 1", name="resource"),
    sa.CheckConstraint("level BETWEEN 1 AND 4", name="level"),
    # Every list checks rights: with all columns that decide, index-only scans suffice.
    sa.Index("uq_access_grant_project", "project_id", "group_id", unique=True, postgresql_include=_DECIDING),
    sa.Index("uq_access_grant_mission", "mission_id", "group_id", unique=True, postgresql_include=_DECIDING),
    sa.Index("ix_access_grant_group_id", "group_id", postgresql_include=["project_id", "mission_id", *_DECIDING]),
    # Separate, because grants on projects are few and grants on missions may be thousands.
    sa.Index(
        "ix_access_grant_projects",
        "group_id",
        postgresql_include=["project_id", *_DECIDING],
        postgresql_where=sa.text("project_id IS NOT NULL"),
    ),
    sa.Index(
        "ix_access_grant_missions",
        "group_id",
        postgresql_include=["mission_id", *_DECIDING],
        postgresql_where=sa.text("mission_id IS NOT NULL"),
    ),
)


share = sa.Table(
    "share",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("name", sa.Text, nullable=False),
    # If false, the files are those in `share_file`.
    sa.Column("is_whole_mission", sa.Boolean, nullable=False),
    sa.Column("prefix", sa.Text, nullable=False),
    sa.Column("secret_sha256", sa.LargeBinary, nullable=False, unique=True),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    created_at_column(),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("revoked_at", sa.DateTime(timezone=True)),
    sa.Column("last_used_at", sa.DateTime(timezone=True)),
    sa.Column("download_count", sa.BigInteger, nullable=False, server_default="0"),
    sa.Column("download_bytes", sa.BigInteger, nullable=False, server_default="0"),
    sa.CheckConstraint("octet_length(secret_sha256) = 32", name="secret_sha256"),
)

share_file = sa.Table(
    "share_file",
    metadata,
    sa.Column("share_id", sa.Uuid, sa.ForeignKey("share.id", ondelete="CASCADE"), nullable=False),
    sa.Column("file_id", sa.Uuid, sa.ForeignKey("file.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.PrimaryKeyConstraint("share_id", "file_id"),
)
