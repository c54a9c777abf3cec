"""People, their addresses, sessions and tokens; groups and what these are granted; links for people without an account.

Every right is a grant to a group. Of a secret only its SHA-256 is stored: it has 256 random bits, so nothing slower is
needed.
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
    # Whoever left: no session, token or sign-in is theirs any more; their name stays in the record.
    sa.Column("deactivated_at", sa.DateTime(timezone=True)),
)

# `verified_by` says whose word it is that the address is theirs: an issuer's URL, or the admin's who invited them.
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
    # How they signed in: `password`, `link`, or the issuer's URL.
    sa.Column("method", sa.Text, nullable=False),
    sa.Column("address", sa.Text),
    sa.Column("user_agent", sa.Text),
    created_at_column(),
    sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.text("now()")),
    sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("revoked_at", sa.DateTime(timezone=True)),
    # When its person last proved who they are, by password or provider; what is sensitive asks for it again.
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
    # The beginning of the secret, by which people recognise it.
    sa.Column("prefix", sa.Text, nullable=False, server_default=""),
    sa.Column("secret_sha256", sa.LargeBinary, nullable=False, unique=True),
    sa.Column("scopes", sa.ARRAY(sa.Text), nullable=False),
    # Whether `token_limit` says all there is for it: without, it reaches whatever its person reaches.
    sa.Column("is_limited", sa.Boolean, nullable=False, server_default=sa.text("false")),
    created_at_column(),
    sa.Column("expires_at", sa.DateTime(timezone=True)),
    sa.Column("last_used_at", sa.DateTime(timezone=True)),
    sa.Column("revoked_at", sa.DateTime(timezone=True)),
    # With which token it was made: it ends with that one. None where somebody was signed in by a browser.
    sa.Column("made_by_token_id", sa.Uuid, sa.ForeignKey("token.id"), index=True),
    # A token of a run is valid while the run lasts, for at most `max_right`; the audit log may name it afterwards.
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="SET NULL"), index=True),
    sa.Column("max_right", sa.Text),
    # A runner's: the one runner that may use it, null until the first one does. With `runner_labels`, that runner gets
    # only runs that ask for one of them.
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

# Rows go with what they name, and the token stays limited.
token_limit = sa.Table(
    "token_limit",
    metadata,
    id_column(),
    sa.Column("token_id", sa.Uuid, sa.ForeignKey("token.id", ondelete="CASCADE"), nullable=False),
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id", ondelete="CASCADE")),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE")),
    sa.CheckConstraint("num_nonnulls(project_id, mission_id) = 1", name="place"),
    sa.Index("ix_token_limit_token_id", "token_id"),
)


access_group = sa.Table(
    "access_group",
    metadata,
    id_column(),
    sa.Column("kind", sa.Text, nullable=False),
    # Of a person's own group this is their name once more, of an e-mail's the address.
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

# What the settings say of an affiliation group: what it gets on each new project, and who is in it. Members come and go
# with the exact domains of verified addresses; a group without a row here is one that the settings name no longer.
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
    # The level of the contract's `Right`.
    sa.Column("level", sa.SmallInteger, nullable=False),
    sa.Column("expires_at", sa.DateTime(timezone=True)),
    created_at_column(),
    sa.Column("granted_by_id", sa.Uuid, sa.ForeignKey("person.id")),
    sa.CheckConstraint("num_nonnulls(project_id, mission_id) = 1", name="place"),
    sa.CheckConstraint("level BETWEEN 1 AND 4", name="level"),
    # Rights are asked for with every list: all of a grant that decides stands in the index itself.
    sa.Index("uq_access_grant_project", "project_id", "group_id", unique=True, postgresql_include=_DECIDING),
    sa.Index("uq_access_grant_mission", "mission_id", "group_id", unique=True, postgresql_include=_DECIDING),
    sa.Index("ix_access_grant_group_id", "group_id", postgresql_include=["project_id", "mission_id", *_DECIDING]),
    # Those on projects are few, and those on missions may be thousands: neither are read for the other.
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
    # Without, `share_file` says which files there are for it.
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
