"""Actions and their versions, runners, and runs with their inputs, results and logs.

A version never changes, but for the digest that its image was first resolved to. Lease and attempt say who executes a
run.
"""

from sqlalchemy import (
    ARRAY,
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    Double,
    ForeignKey,
    Identity,
    Index,
    Integer,
    LargeBinary,
    PrimaryKeyConstraint,
    Table,
    Text,
    UniqueConstraint,
    Uuid,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.actions import Network
from kleinkram.contract.reports import Severity
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

action = Table(
    "action",
    metadata,
    id_column(),
    # Null: the whole lab's.
    Column("project_id", Uuid, ForeignKey("project.id", ondelete="CASCADE")),
    sorted_text("name"),
    sorted_text("name_key"),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    created_at_column(),
    Column("archived_at", DateTime(timezone=True)),
    Index(
        "uq_action_name_key_live",
        "project_id",
        "name_key",
        unique=True,
        postgresql_where=text("archived_at IS NULL"),
        postgresql_nulls_not_distinct=True,
    ),
    Index("ix_action_name", "name", "id"),
)

action_version = Table(
    "action_version",
    metadata,
    id_column(),
    # Null, with its number, where it was run without being published.
    Column("action_id", Uuid, ForeignKey("action.id", ondelete="CASCADE")),
    Column("number", Integer),
    Column("definition", JSONB, nullable=False),
    Column("definition_sha256", LargeBinary, nullable=False),
    Column("image_digest", Text),
    Column("created_by_id", Uuid, ForeignKey("person.id"), nullable=False),
    created_at_column(),
    UniqueConstraint("action_id", "number"),
    CheckConstraint("(action_id IS NULL) = (number IS NULL)", name="published"),
    Index(
        "uq_action_version_unpublished",
        "definition_sha256",
        unique=True,
        postgresql_where=text("action_id IS NULL"),
    ),
)


runner = Table(
    "runner",
    metadata,
    id_column(),
    Column("person_id", Uuid, ForeignKey("person.id"), nullable=False, index=True),
    # The token with which it last said hello. No foreign key: tokens of runs refer to runs, and these to runners.
    Column("token_id", Uuid),
    Column("name", Text, nullable=False),
    Column("labels", ARRAY(Text), nullable=False, server_default="{}"),
    Column("capacity", JSONB, nullable=False),
    Column("abilities", JSONB, nullable=False),
    Column("default_image", Text),
    Column("version", Text, nullable=False),
    created_at_column(),
    Column("last_seen_at", DateTime(timezone=True), nullable=False, server_default=text("now()")),
)


ASSIGNED = (RunState.preparing.value, RunState.running.value, RunState.collecting.value)
ACTIVE = (RunState.queued.value, *ASSIGNED)

run = Table(
    "run",
    metadata,
    id_column(),
    Column("mission_id", Uuid, ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    Column("version_id", Uuid, ForeignKey("action_version.id"), nullable=False, index=True),
    Column("parameters", JSONB, nullable=False),
    Column("network", Text, nullable=False),
    # What a runner must have free, and be called, for this: out of the definition, so that a claim is one look.
    Column("cores", Double, nullable=False),
    Column("memory_bytes", BigInteger, nullable=False),
    Column("disk_bytes", BigInteger, nullable=False),
    Column("gpus", Integer, nullable=False),
    Column("labels", ARRAY(Text), nullable=False, server_default="{}"),
    Column("needs_images", Boolean, nullable=False),
    Column("state", Text, nullable=False, server_default=RunState.queued.value),
    Column("reason", Text),
    Column("message", Text, nullable=False, server_default=""),
    Column("exit_code", Integer),
    Column("image_digest", Text),
    # The SHA-256 of all that decides about its results, but for the image.
    Column("inputs_fingerprint", LargeBinary, nullable=False),
    Column("reuses_id", Uuid, ForeignKey("run.id", ondelete="SET NULL"), index=True),
    Column("retry_of_id", Uuid, ForeignKey("run.id", ondelete="SET NULL"), index=True),
    Column("started_by_id", Uuid, ForeignKey("person.id"), nullable=False, index=True),
    Column("attempt", Integer, nullable=False, server_default="0"),
    # How often a runner was lost with it.
    Column("lost_count", Integer, nullable=False, server_default="0"),
    Column("runner_id", Uuid, ForeignKey("runner.id"), index=True),
    Column("lease_ends_at", DateTime(timezone=True)),
    Column("progress", JSONB(none_as_null=True)),
    Column("usage", JSONB(none_as_null=True)),
    Column("samples", JSONB, nullable=False, server_default="[]"),
    Column("problems", JSONB, nullable=False, server_default="[]"),
    Column("proposed", JSONB, nullable=False, server_default="{}"),
    Column("previews", JSONB, nullable=False, server_default="[]"),
    Column("input_count", Integer, nullable=False),
    Column("input_bytes", BigInteger, nullable=False),
    Column("artifact_count", Integer, nullable=False, server_default="0"),
    Column("metric_count", Integer, nullable=False, server_default="0"),
    # By severity.
    Column("finding_counts", JSONB, nullable=False, server_default="{}"),
    Column("log_blob_id", Uuid, ForeignKey("blob.id"), index=True),
    created_at_column(),
    Column("claimed_at", DateTime(timezone=True)),
    Column("started_at", DateTime(timezone=True)),
    Column("ended_at", DateTime(timezone=True)),
    Column("cancel_requested_at", DateTime(timezone=True)),
    one_of("state", RunState),
    one_of("reason", EndReason),
    one_of("network", Network),
    CheckConstraint("(ended_at IS NULL) = (state IN ('queued', 'preparing', 'running', 'collecting'))", name="ended"),
    CheckConstraint(
        "(lease_ends_at IS NOT NULL) = (state IN ('preparing', 'running', 'collecting'))"
        " AND (state NOT IN ('preparing', 'running', 'collecting') OR runner_id IS NOT NULL)",
        name="held",
    ),
    Index("ix_run_queue", "created_at", "id", postgresql_where=text("state = 'queued'")),
    Index(
        "ix_run_lease_ends_at",
        "lease_ends_at",
        postgresql_where=text("state IN ('preparing', 'running', 'collecting')"),
    ),
    Index("ix_run_created_at", "created_at", "id"),
    Index("ix_run_mission_id", "mission_id", "created_at"),
    Index("ix_run_inputs", "inputs_fingerprint", postgresql_where=text("state = 'done'")),
)

# The hash stays when the file, or its bytes, are gone; a blob is kept while a run that is not over names it here.
run_input = Table(
    "run_input",
    metadata,
    Column("run_id", Uuid, ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    sorted_text("path"),
    Column("size_bytes", BigInteger, nullable=False),
    Column("sha256", LargeBinary, nullable=False),
    Column("blob_id", Uuid, ForeignKey("blob.id", ondelete="SET NULL"), index=True),
    Column("file_id", Uuid, ForeignKey("file.id", ondelete="SET NULL"), index=True),
    PrimaryKeyConstraint("run_id", "path"),
)

# `file_id` and `made_from` are there where it was put back into the mission; `made_from` empty: from all inputs.
run_artifact = Table(
    "run_artifact",
    metadata,
    id_column(),
    Column("run_id", Uuid, ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    sorted_text("path"),
    Column("blob_id", Uuid, ForeignKey("blob.id"), nullable=False, index=True),
    Column("file_id", Uuid, ForeignKey("file.id", ondelete="SET NULL"), index=True),
    Column("made_from", ARRAY(Text)),
    UniqueConstraint("run_id", "path"),
)

run_finding = Table(
    "run_finding",
    metadata,
    Column("id", BigInteger, Identity(always=True), primary_key=True),
    Column("run_id", Uuid, ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    Column("severity", Text, nullable=False),
    sorted_text("code"),
    Column("message", Text, nullable=False),
    Column("file", Text),
    Column("topic", Text),
    Column("time_ns", BigInteger),
    one_of("severity", Severity),
    Index("ix_run_finding_run_id", "run_id", "id"),
    Index("ix_run_finding_code", "code", "id"),
)

run_metric = Table(
    "run_metric",
    metadata,
    Column("id", BigInteger, Identity(always=True), primary_key=True),
    Column("run_id", Uuid, ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    Column("value", Double, nullable=False),
    Column("unit", Text),
    Column("file", Text),
    Index("ix_run_metric_run_id", "run_id", "id"),
    Index("ix_run_metric_name", "name", "id"),
)

# Pieces of logs in the store. Without a run they, and then their rows, are swept.
log_chunk = Table(
    "log_chunk",
    metadata,
    Column("key", Text, primary_key=True),
    Column("store_id", Text, nullable=False, server_default="main"),
    Column("run_id", Uuid, ForeignKey("run.id", ondelete="SET NULL")),
    Column("attempt", Integer, nullable=False),
    Column("offset_bytes", BigInteger, nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    # Null until the runner said that it is there.
    Column("kept_at", DateTime(timezone=True)),
    created_at_column(),
    Index("ix_log_chunk_run_id", "run_id", "attempt", "offset_bytes"),
)
