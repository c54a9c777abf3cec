"""Tables of actions and their versions, runners, and runs with their inputs, results and logs.

A version never changes, except that the digest of its image is added when it is first resolved. Lease and attempt
identify the runner that executes a run.
"""

import uuid

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.actions import Network
from kleinkram.contract.checks import CheckStatus, Verdict
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.project_actions import RunTrigger
from kleinkram.contract.reports import Severity
from kleinkram.contract.runners import LEASE_S
from kleinkram.contract.runs import EndReason, RunPriority, RunState
from kleinkram.server.tables.base import created_at_column, id_column, metadata, one_of, sorted_text

action = sa.Table(
    "action",
    metadata,
    id_column(),
    # Null for actions of the whole lab.
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id", ondelete="CASCADE")),
    sorted_text("name"),
    sorted_text("name_key"),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    created_at_column(),
    sa.Column("archived_at", sa.DateTime(timezone=True)),
    sa.Index(
        "uq_action_name_key_live",
        "project_id",
        "name_key",
        unique=True,
        postgresql_where=sa.text("archived_at IS NULL"),
        postgresql_nulls_not_distinct=True,
    ),
    sa.Index("ix_action_name", "name", "id"),
)

action_version = sa.Table(
    "action_version",
    metadata,
    id_column(),
    # Null, like the number, for a definition that was run without being published.
    sa.Column("action_id", sa.Uuid, sa.ForeignKey("action.id", ondelete="CASCADE")),
    sa.Column("number", sa.Integer),
    sa.Column("definition", JSONB, nullable=False),
    sa.Column("definition_sha256", sa.LargeBinary, nullable=False),
    sa.Column("image_digest", sa.Text),
    sa.Column("created_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    created_at_column(),
    sa.UniqueConstraint("action_id", "number"),
    sa.CheckConstraint("(action_id IS NULL) = (number IS NULL)", name="published"),
    sa.Index(
        "uq_action_version_unpublished",
        "definition_sha256",
        unique=True,
        postgresql_where=sa.text("action_id IS NULL"),
    ),
)


runner = sa.Table(
    "runner",
    metadata,
    id_column(),
    sa.Column("person_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False, index=True),
    # The token with which it last registered. No foreign key: tokens of runs refer to runs, and these to runners.
    sa.Column("token_id", sa.Uuid),
    sa.Column("name", sa.Text, nullable=False),
    sa.Column("labels", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    sa.Column("capacity", JSONB, nullable=False),
    sa.Column("abilities", JSONB, nullable=False),
    sa.Column("default_image", sa.Text),
    sa.Column("version", sa.Text, nullable=False),
    sa.Column("lease_s", sa.Integer, nullable=False, server_default=str(LEASE_S)),
    created_at_column(),
    sa.Column("last_seen_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.text("now()")),
)


ASSIGNED = (RunState.preparing.value, RunState.running.value, RunState.collecting.value)
ACTIVE = (RunState.queued.value, *ASSIGNED)

run = sa.Table(
    "run",
    metadata,
    id_column(),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    sa.Column("version_id", sa.Uuid, sa.ForeignKey("action_version.id"), nullable=False, index=True),
    sa.Column("parameters", JSONB, nullable=False),
    sa.Column("network", sa.Text, nullable=False),
    # Resources and labels that a runner must have, copied from the definition so that a claim is one query.
    sa.Column("cores", sa.Double, nullable=False),
    sa.Column("memory_bytes", sa.BigInteger, nullable=False),
    sa.Column("disk_bytes", sa.BigInteger, nullable=False),
    sa.Column("gpus", sa.Integer, nullable=False),
    sa.Column("labels", sa.ARRAY(sa.Text), nullable=False, server_default="{}"),
    sa.Column("needs_images", sa.Boolean, nullable=False),
    sa.Column("priority", sa.Text, nullable=False, server_default=RunPriority.normal.value),
    # The project of its mission at the launch, whose turn it takes in the queue; zero for runs of earlier versions.
    sa.Column("launch_project_id", sa.Uuid, nullable=False, server_default=str(uuid.UUID(int=0))),
    sa.Column("state", sa.Text, nullable=False, server_default=RunState.queued.value),
    sa.Column("reason", sa.Text),
    sa.Column("message", sa.Text, nullable=False, server_default=""),
    sa.Column("exit_code", sa.Integer),
    sa.Column("image_digest", sa.Text),
    # SHA-256 of everything that determines its results, except the image.
    sa.Column("inputs_fingerprint", sa.LargeBinary, nullable=False),
    # What its action declares to read beside files, as it was at the launch: metadata by name, and the `checks.yaml`.
    # All metadata and the `checks.yaml`, if they name the reference that it reads.
    sa.Column("input_metadata", JSONB(none_as_null=True)),
    sa.Column("checks_sha256", sa.LargeBinary),
    sa.Column("reuses_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="SET NULL"), index=True),
    # It was executed elsewhere, and recorded with its results.
    sa.Column("is_recorded", sa.Boolean, nullable=False, server_default=sa.text("false")),
    sa.Column("retry_of_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="SET NULL"), index=True),
    sa.Column("started_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    sa.Column("attempt", sa.Integer, nullable=False, server_default="0"),
    # How many times its runner was lost.
    sa.Column("lost_count", sa.Integer, nullable=False, server_default="0"),
    sa.Column("runner_id", sa.Uuid, sa.ForeignKey("runner.id")),
    sa.Column("lease_ends_at", sa.DateTime(timezone=True)),
    # What its runner gave it; null before a runner has it.
    sa.Column("isolation", sa.Text),
    sa.Column("progress", JSONB(none_as_null=True)),
    sa.Column("placement", JSONB(none_as_null=True)),
    sa.Column("usage", JSONB(none_as_null=True)),
    sa.Column("samples", JSONB, nullable=False, server_default="[]"),
    sa.Column("problems", JSONB, nullable=False, server_default="[]"),
    sa.Column("proposed", JSONB, nullable=False, server_default="{}"),
    sa.Column("previews", JSONB, nullable=False, server_default="[]"),
    sa.Column("input_count", sa.Integer, nullable=False),
    sa.Column("input_bytes", sa.BigInteger, nullable=False),
    sa.Column("artifact_count", sa.Integer, nullable=False, server_default="0"),
    sa.Column("metric_count", sa.Integer, nullable=False, server_default="0"),
    # Good, warnings or bad, of a run that is done; null where it judged nothing.
    sa.Column("verdict", sa.Text),
    # By status.
    sa.Column("check_counts", JSONB, nullable=False, server_default="{}"),
    # By severity.
    sa.Column("finding_counts", JSONB, nullable=False, server_default="{}"),
    sa.Column("log_blob_id", sa.Uuid, sa.ForeignKey("blob.id"), index=True),
    # Of the request or job that launched it, for its runner.
    sa.Column("traceparent", sa.Text),
    created_at_column(),
    sa.Column("claimed_at", sa.DateTime(timezone=True)),
    sa.Column("started_at", sa.DateTime(timezone=True)),
    sa.Column("ended_at", sa.DateTime(timezone=True)),
    sa.Column("cancel_requested_at", sa.DateTime(timezone=True)),
    one_of("state", RunState),
    one_of("reason", EndReason),
    one_of("network", Network),
    one_of("priority", RunPriority),
    one_of("isolation", Isolation),
    one_of("verdict", Verdict),
    sa.CheckConstraint(
        "(ended_at IS NULL) = (state IN ('queued', 'preparing', 'running', 'collecting'))", name="ended"
    ),
    sa.CheckConstraint(
        "(lease_ends_at IS NOT NULL) = (state IN ('preparing', 'running', 'collecting'))"
        " AND (state NOT IN ('preparing', 'running', 'collecting') OR runner_id IS NOT NULL)",
        name="assigned",
    ),
    sa.Index(
        "ix_run_queue",
        *("priority", "launch_project_id", "started_by_id", "created_at", "id"),
        postgresql_where=sa.text("state = 'queued'"),
    ),
    # Not of `lease_ends_at`: then heartbeats, which change little else, do not write to the indexes.
    sa.Index(
        "ix_run_assigned",
        "runner_id",
        postgresql_where=sa.text("state IN ('preparing', 'running', 'collecting')"),
    ),
    # The last starts of a project and of a person.
    sa.Index("ix_run_launch_project_id", "launch_project_id", "claimed_at"),
    sa.Index("ix_run_started_by_id", "started_by_id", "claimed_at"),
    sa.Index("ix_run_created_at", "created_at", "id"),
    # Lists of active runs beside any number of ended ones, and their number.
    sa.Index(
        "ix_run_active",
        *("created_at", "id"),
        postgresql_include=["mission_id"],
        postgresql_where=sa.text("state IN ('queued', 'preparing', 'running', 'collecting')"),
    ),
    sa.Index("ix_run_mission_id", "mission_id", "created_at"),
    sa.Index("ix_run_job_id", sa.text("(placement ->> 'job_id')"), postgresql_where=sa.text("placement IS NOT NULL")),
    sa.Index(
        "ix_run_node",
        sa.text("(placement ->> 'node')"),
        "created_at",
        "id",
        postgresql_where=sa.text("placement IS NOT NULL"),
    ),
    sa.Index("ix_run_inputs", "inputs_fingerprint", postgresql_where=sa.text("state = 'done'")),
)

# The hash stays after the file or its bytes are deleted. A blob is kept while an unfinished run refers to it here.
run_input = sa.Table(
    "run_input",
    metadata,
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    sorted_text("path"),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    sa.Column("sha256", sa.LargeBinary, nullable=False),
    sa.Column("blob_id", sa.Uuid, sa.ForeignKey("blob.id", ondelete="SET NULL"), index=True),
    sa.Column("file_id", sa.Uuid, sa.ForeignKey("file.id", ondelete="SET NULL"), index=True),
    sa.PrimaryKeyConstraint("run_id", "path"),
)

# `file_id` and `derived_from` are set if it became a file of the mission; an empty `derived_from` means all inputs.
run_artifact = sa.Table(
    "run_artifact",
    metadata,
    id_column(),
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    sorted_text("path"),
    sa.Column("blob_id", sa.Uuid, sa.ForeignKey("blob.id"), nullable=False, index=True),
    sa.Column("file_id", sa.Uuid, sa.ForeignKey("file.id", ondelete="SET NULL"), index=True),
    sa.Column("derived_from", sa.ARRAY(sa.Text)),
    sa.UniqueConstraint("run_id", "path"),
)

run_finding = sa.Table(
    "run_finding",
    metadata,
    sa.Column("id", sa.BigInteger, sa.Identity(always=True), primary_key=True),
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    sa.Column("severity", sa.Text, nullable=False),
    sorted_text("code"),
    sa.Column("message", sa.Text, nullable=False),
    sa.Column("file", sa.Text),
    sa.Column("topic", sa.Text),
    sa.Column("time_ns", sa.BigInteger),
    one_of("severity", Severity),
    sa.Index("ix_run_finding_run_id", "run_id", "id"),
    sa.Index("ix_run_finding_code", "code", "id"),
)

run_check = sa.Table(
    "run_check",
    metadata,
    sa.Column("id", sa.BigInteger, sa.Identity(always=True), primary_key=True),
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    sa.Column("status", sa.Text, nullable=False),
    sa.Column("message", sa.Text, nullable=False),
    sa.Column("value", sa.Double),
    sa.Column("limit", sa.Double),
    sa.Column("unit", sa.Text),
    sa.Column("topic", sa.Text),
    sa.Column("file", sa.Text),
    sa.Column("time_ns", sa.BigInteger),
    one_of("status", CheckStatus),
    sa.Index("ix_run_check_run_id", "run_id", "id"),
    sa.Index("ix_run_check_name", "name", "id"),
)

run_metric = sa.Table(
    "run_metric",
    metadata,
    sa.Column("id", sa.BigInteger, sa.Identity(always=True), primary_key=True),
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="CASCADE"), nullable=False),
    sorted_text("name"),
    sa.Column("value", sa.Double, nullable=False),
    sa.Column("unit", sa.Text),
    sa.Column("file", sa.Text),
    sa.Column("topic", sa.Text),
    sa.Column("labels", JSONB, nullable=False, server_default="{}"),
    sa.Index("ix_run_metric_run_id", "run_id", "id"),
    sa.Index("ix_run_metric_name", "name", "id"),
)

# An action that a project names: it runs by itself, for the person who added it.
project_action = sa.Table(
    "project_action",
    metadata,
    id_column(),
    sa.Column("project_id", sa.Uuid, sa.ForeignKey("project.id", ondelete="CASCADE"), nullable=False),
    sa.Column("action_id", sa.Uuid, sa.ForeignKey("action.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("trigger", sa.Text, nullable=False),
    sa.Column("idle_s", sa.Integer),
    sa.Column("parameters", JSONB, nullable=False),
    sa.Column("added_by_id", sa.Uuid, sa.ForeignKey("person.id"), nullable=False),
    created_at_column(),
    sa.UniqueConstraint("project_id", "action_id"),
    one_of("trigger", RunTrigger),
    sa.CheckConstraint("(trigger = 'idle') = (idle_s IS NOT NULL)", name="idle"),
)

# What was decided for a mission, as of its `files_revision` and the `checks_number` of its project: a run, none, or a
# problem.
project_action_mission = sa.Table(
    "project_action_mission",
    metadata,
    sa.Column("project_action_id", sa.Uuid, sa.ForeignKey("project_action.id", ondelete="CASCADE"), nullable=False),
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("files_revision", sa.BigInteger, nullable=False),
    sa.Column("checks_number", sa.Integer),
    sa.Column("problem", sa.Text),
    sa.Column("retry_at", sa.DateTime(timezone=True)),
    sa.Column("decided_at", sa.DateTime(timezone=True), nullable=False, server_default=sa.text("now()")),
    sa.PrimaryKeyConstraint("project_action_id", "mission_id"),
)

# The primary key makes each start by itself happen once; it stays when the run is deleted.
automatic_run = sa.Table(
    "automatic_run",
    metadata,
    sa.Column("mission_id", sa.Uuid, sa.ForeignKey("mission.id", ondelete="CASCADE"), nullable=False),
    sa.Column(
        "version_id", sa.Uuid, sa.ForeignKey("action_version.id", ondelete="CASCADE"), nullable=False, index=True
    ),
    # Of the parameters, the paths and bytes of the recorded inputs, and what it declares to read beside files.
    sa.Column("inputs_sha256", sa.LargeBinary, nullable=False),
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="SET NULL"), index=True),
    created_at_column(),
    sa.PrimaryKeyConstraint("mission_id", "version_id", "inputs_sha256"),
)

# Complete logs of ended runs that are small: they need no object in the store.
run_log = sa.Table(
    "run_log",
    metadata,
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("content", sa.LargeBinary, nullable=False),
)

# Chunks of logs in the store. Without a run, the objects and then the rows are deleted as garbage.
log_chunk = sa.Table(
    "log_chunk",
    metadata,
    sa.Column("key", sa.Text, primary_key=True),
    sa.Column("store_id", sa.Text, nullable=False, server_default="main"),
    sa.Column("run_id", sa.Uuid, sa.ForeignKey("run.id", ondelete="SET NULL")),
    sa.Column("attempt", sa.Integer, nullable=False),
    sa.Column("offset_bytes", sa.BigInteger, nullable=False),
    sa.Column("size_bytes", sa.BigInteger, nullable=False),
    # Null until the runner confirmed the upload.
    sa.Column("confirmed_at", sa.DateTime(timezone=True)),
    created_at_column(),
    sa.Index("ix_log_chunk_run_id", "run_id", "attempt", "offset_bytes"),
)
