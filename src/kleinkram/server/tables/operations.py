"""Tables of the audit log, the last errors of jobs, the worker processes, and attempts at backups.

The serving role can only add to the audit log and read it. Beyond that, it may call two functions of the migrations:
one replaces the names of an erased person, the other deletes events that are older than `audit_retention` says. A row
of `job_error` is deleted with its job, by a foreign key that only the migration declares.
"""

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.server.tables.base import metadata

audit_event = sa.Table(
    "audit_event",
    metadata,
    sa.Column("id", sa.BigInteger, sa.Identity(always=True), primary_key=True),
    sa.Column("at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    sa.Column("actor_id", sa.Uuid, sa.ForeignKey("person.id")),
    sa.Column("token_id", sa.Uuid, sa.ForeignKey("token.id")),
    sa.Column("session_id", sa.Uuid, sa.ForeignKey("session.id")),
    # The share link of a guest; kept when the link is deleted.
    sa.Column("share_id", sa.Uuid),
    sa.Column("address", sa.Text),
    # Whether it required admin rights: without them, it would have been refused.
    sa.Column("as_admin", sa.Boolean, nullable=False, server_default=sa.text("false")),
    sa.Column("operation", sa.Text, nullable=False),
    sa.Column("resource_type", sa.Text, nullable=False),
    # No foreign keys: entries outlive the objects.
    sa.Column("resource_id", sa.Uuid),
    sa.Column("resource_name", sa.Text, nullable=False),
    sa.Column("project_id", sa.Uuid),
    sa.Column("mission_id", sa.Uuid),
    sa.Column("before", JSONB, nullable=False, server_default="{}"),
    sa.Column("after", JSONB, nullable=False, server_default="{}"),
    sa.Column("request_id", sa.Text),
    sa.Index("ix_audit_event_resource_id", "resource_id", "id"),
    sa.Index("ix_audit_event_project_id", "project_id", "id"),
    sa.Index("ix_audit_event_mission_id", "mission_id", "id"),
    sa.Index("ix_audit_event_actor_id", "actor_id", "id"),
    sa.Index("ix_audit_event_token_id", "token_id", "id"),
    sa.Index("ix_audit_event_at", "at", postgresql_using="brin"),
    sa.Index("ix_audit_event_as_admin", "id", postgresql_where=sa.text("as_admin")),
)

# How many days events are kept: at most one row, which `migrate` writes; without it, they are kept forever.
audit_retention = sa.Table(
    "audit_retention",
    metadata,
    sa.Column("is_set", sa.Boolean, primary_key=True, server_default=sa.true()),
    sa.Column("days", sa.Integer, nullable=False),
    sa.CheckConstraint("is_set", name="is_set"),
    sa.CheckConstraint("days >= 30", name="days"),
)


job_error = sa.Table(
    "job_error",
    metadata,
    sa.Column("job_id", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("sentence", sa.Text, nullable=False),
)


worker_process = sa.Table(
    "worker_process",
    metadata,
    sa.Column("id", sa.Uuid, primary_key=True),
    sa.Column("host", sa.Text, nullable=False),
    sa.Column("pid", sa.Integer, nullable=False),
    sa.Column("version", sa.Text, nullable=False),
    sa.Column("started_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    sa.Column("seen_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    sa.Column("ended_at", sa.DateTime(timezone=True)),
)


backup_attempt = sa.Table(
    "backup_attempt",
    metadata,
    sa.Column("id", sa.Uuid, primary_key=True),
    # The moment that the backup shows.
    sa.Column("started_at", sa.DateTime(timezone=True), nullable=False),
    sa.Column("ended_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.func.now()),
    # Null if it failed.
    sa.Column("snapshot_id", sa.Text),
    # Objects that were lost or corrupt in the store.
    sa.Column("damaged_objects", sa.BigInteger, nullable=False, server_default="0"),
    sa.Index("ix_backup_attempt_ended_at", "ended_at"),
)
