"""Groups, who is in them until when, and what they are granted. Every right is a grant to a group."""

from sqlalchemy import (
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    ForeignKey,
    Index,
    PrimaryKeyConstraint,
    SmallInteger,
    Table,
    Text,
    Uuid,
    text,
)

from kleinkram.contract.access import GroupKind
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

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
