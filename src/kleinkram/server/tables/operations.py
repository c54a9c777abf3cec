"""The audit log, the last errors of jobs, and the worker processes.

The serving role of the database may add to the audit log and read it, nothing else. A row of `job_error` goes with
its job, by a foreign key that only the migration names.
"""

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    DateTime,
    ForeignKey,
    Identity,
    Index,
    Integer,
    Table,
    Text,
    Uuid,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.server.tables.base import metadata

audit_event = Table(
    "audit_event",
    metadata,
    Column("id", BigInteger, Identity(always=True), primary_key=True),
    Column("at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("actor_id", Uuid, ForeignKey("person.id")),
    Column("token_id", Uuid, ForeignKey("token.id")),
    Column("session_id", Uuid, ForeignKey("session.id")),
    # The link by which somebody without an account came; kept when the link is gone.
    Column("share_id", Uuid),
    Column("address", Text),
    # Whether it took the power of an admin: without it, it would have been refused.
    Column("as_admin", Boolean, nullable=False, server_default=text("false")),
    Column("operation", Text, nullable=False),
    Column("noun", Text, nullable=False),
    # No foreign keys: the record outlives what it speaks of.
    Column("noun_id", Uuid),
    Column("noun_name", Text, nullable=False),
    Column("project_id", Uuid),
    Column("mission_id", Uuid),
    Column("before", JSONB, nullable=False, server_default="{}"),
    Column("after", JSONB, nullable=False, server_default="{}"),
    Column("request_id", Text),
    Index("ix_audit_event_noun_id", "noun_id", "id"),
    Index("ix_audit_event_project_id", "project_id", "id"),
    Index("ix_audit_event_mission_id", "mission_id", "id"),
    Index("ix_audit_event_actor_id", "actor_id", "id"),
    Index("ix_audit_event_token_id", "token_id", "id"),
    Index("ix_audit_event_at", "at", postgresql_using="brin"),
    Index("ix_audit_event_as_admin", "id", postgresql_where=text("as_admin")),
)


job_error = Table(
    "job_error",
    metadata,
    Column("job_id", BigInteger, primary_key=True, autoincrement=False),
    Column("sentence", Text, nullable=False),
)


worker_process = Table(
    "worker_process",
    metadata,
    Column("id", Uuid, primary_key=True),
    Column("host", Text, nullable=False),
    Column("pid", Integer, nullable=False),
    Column("version", Text, nullable=False),
    Column("started_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("seen_at", DateTime(timezone=True), nullable=False, server_default=func.now()),
    Column("ended_at", DateTime(timezone=True)),
)
