"""Actions, runners and runs."""

import sqlalchemy as sa
from alembic import context, op
from sqlalchemy.dialects import postgresql

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None

_TABLES = "runner, action, action_version, run, run_input, run_artifact, run_finding, run_metric, log_chunk"


def upgrade() -> None:
    _make_runners()
    _make_actions()
    _make_runs()
    _index_runs()
    _make_files_of_runs()
    _make_words_of_runs()
    _open_others_to_runs()
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON {_TABLES} TO {role}")


def _make_runners() -> None:
    op.create_table(
        "runner",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("labels", sa.ARRAY(sa.Text()), server_default="{}", nullable=False),
        sa.Column("capacity", postgresql.JSONB(), nullable=False),
        sa.Column("abilities", postgresql.JSONB(), nullable=False),
        sa.Column("default_image", sa.Text(), nullable=True),
        sa.Column("version", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("last_seen_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_runner_person_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_runner")),
    )
    op.create_index(op.f("ix_runner_person_id"), "runner", ["person_id"], unique=False)


def _make_actions() -> None:
    op.create_table(
        "action",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("project_id", sa.Uuid(), nullable=True),
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.Column("name_key", sa.Text(collation="C"), nullable=False),
        sa.Column("created_by_id", sa.Uuid(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("archived_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(["created_by_id"], ["person.id"], name=op.f("fk_action_created_by_id_person")),
        sa.ForeignKeyConstraint(
            ["project_id"], ["project.id"], name=op.f("fk_action_project_id_project"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_action")),
    )
    op.create_index("ix_action_name", "action", ["name", "id"], unique=False)
    op.create_index(
        "uq_action_name_key_live",
        "action",
        ["project_id", "name_key"],
        unique=True,
        postgresql_where=sa.text("archived_at IS NULL"),
        postgresql_nulls_not_distinct=True,
    )
    op.create_table(
        "action_version",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("action_id", sa.Uuid(), nullable=True),
        sa.Column("number", sa.Integer(), nullable=True),
        sa.Column("definition", postgresql.JSONB(), nullable=False),
        sa.Column("definition_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("image_digest", sa.Text(), nullable=True),
        sa.Column("created_by_id", sa.Uuid(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("(action_id IS NULL) = (number IS NULL)", name=op.f("ck_action_version_published")),
        sa.ForeignKeyConstraint(
            ["action_id"], ["action.id"], name=op.f("fk_action_version_action_id_action"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["created_by_id"], ["person.id"], name=op.f("fk_action_version_created_by_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_action_version")),
        sa.UniqueConstraint("action_id", "number", name=op.f("uq_action_version_action_id_number")),
    )
    op.create_index(
        "uq_action_version_unpublished",
        "action_version",
        ["definition_sha256"],
        unique=True,
        postgresql_where=sa.text("action_id IS NULL"),
    )


def _make_runs() -> None:
    op.create_table(
        "run",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("mission_id", sa.Uuid(), nullable=False),
        sa.Column("version_id", sa.Uuid(), nullable=False),
        sa.Column("parameters", postgresql.JSONB(), nullable=False),
        sa.Column("network", sa.Text(), nullable=False),
        sa.Column("cores", sa.Double(), nullable=False),
        sa.Column("memory_bytes", sa.BigInteger(), nullable=False),
        sa.Column("disk_bytes", sa.BigInteger(), nullable=False),
        sa.Column("gpus", sa.Integer(), nullable=False),
        sa.Column("labels", sa.ARRAY(sa.Text()), server_default="{}", nullable=False),
        sa.Column("needs_images", sa.Boolean(), nullable=False),
        sa.Column("state", sa.Text(), server_default="queued", nullable=False),
        sa.Column("reason", sa.Text(), nullable=True),
        sa.Column("message", sa.Text(), server_default="", nullable=False),
        sa.Column("exit_code", sa.Integer(), nullable=True),
        sa.Column("image_digest", sa.Text(), nullable=True),
        sa.Column("given_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("reuses_id", sa.Uuid(), nullable=True),
        sa.Column("retry_of_id", sa.Uuid(), nullable=True),
        sa.Column("started_by_id", sa.Uuid(), nullable=False),
        sa.Column("attempt", sa.Integer(), server_default="0", nullable=False),
        sa.Column("lost_count", sa.Integer(), server_default="0", nullable=False),
        sa.Column("runner_id", sa.Uuid(), nullable=True),
        sa.Column("lease_ends_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("progress", postgresql.JSONB(), nullable=True),
        sa.Column("usage", postgresql.JSONB(), nullable=True),
        sa.Column("samples", postgresql.JSONB(), server_default="[]", nullable=False),
        sa.Column("problems", postgresql.JSONB(), server_default="[]", nullable=False),
        sa.Column("proposed", postgresql.JSONB(), server_default="{}", nullable=False),
        sa.Column("previews", postgresql.JSONB(), server_default="[]", nullable=False),
        sa.Column("input_count", sa.Integer(), nullable=False),
        sa.Column("input_bytes", sa.BigInteger(), nullable=False),
        sa.Column("artifact_count", sa.Integer(), server_default="0", nullable=False),
        sa.Column("metric_count", sa.Integer(), server_default="0", nullable=False),
        sa.Column("finding_counts", postgresql.JSONB(), server_default="{}", nullable=False),
        sa.Column("log_blob_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("claimed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("cancel_requested_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "(ended_at IS NULL) = (state IN ('queued', 'preparing', 'running', 'collecting'))",
            name=op.f("ck_run_ended"),
        ),
        sa.CheckConstraint(
            "(lease_ends_at IS NOT NULL) = (state IN ('preparing', 'running', 'collecting'))"
            " AND (state NOT IN ('preparing', 'running', 'collecting') OR runner_id IS NOT NULL)",
            name=op.f("ck_run_held"),
        ),
        sa.CheckConstraint("network IN ('none', 'api', 'open')", name=op.f("ck_run_network")),
        sa.CheckConstraint(
            "reason IN ('done', 'exit_code', 'signal', 'memory', 'time', 'disk', 'cancelled', 'command_not_found',"
            " 'image_unavailable', 'not_possible', 'inputs_unavailable', 'broken_report', 'results_not_kept', 'lost')",
            name=op.f("ck_run_reason"),
        ),
        sa.CheckConstraint(
            "state IN ('queued', 'preparing', 'running', 'collecting', 'done', 'failed', 'cancelled')",
            name=op.f("ck_run_state"),
        ),
        sa.ForeignKeyConstraint(["log_blob_id"], ["blob.id"], name=op.f("fk_run_log_blob_id_blob")),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_run_mission_id_mission"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["retry_of_id"], ["run.id"], name=op.f("fk_run_retry_of_id_run"), ondelete="SET NULL"),
        sa.ForeignKeyConstraint(["reuses_id"], ["run.id"], name=op.f("fk_run_reuses_id_run"), ondelete="SET NULL"),
        sa.ForeignKeyConstraint(["runner_id"], ["runner.id"], name=op.f("fk_run_runner_id_runner")),
        sa.ForeignKeyConstraint(["started_by_id"], ["person.id"], name=op.f("fk_run_started_by_id_person")),
        sa.ForeignKeyConstraint(["version_id"], ["action_version.id"], name=op.f("fk_run_version_id_action_version")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_run")),
    )


def _index_runs() -> None:
    op.create_index("ix_run_created_at", "run", ["created_at", "id"], unique=False)
    op.create_index("ix_run_given", "run", ["given_sha256"], unique=False, postgresql_where=sa.text("state = 'done'"))
    op.create_index(
        "ix_run_lease_ends_at",
        "run",
        ["lease_ends_at"],
        unique=False,
        postgresql_where=sa.text("state IN ('preparing', 'running', 'collecting')"),
    )
    op.create_index(op.f("ix_run_log_blob_id"), "run", ["log_blob_id"], unique=False)
    op.create_index("ix_run_mission_id", "run", ["mission_id", "created_at"], unique=False)
    op.create_index(
        "ix_run_queue", "run", ["created_at", "id"], unique=False, postgresql_where=sa.text("state = 'queued'")
    )
    op.create_index(op.f("ix_run_retry_of_id"), "run", ["retry_of_id"], unique=False)
    op.create_index(op.f("ix_run_reuses_id"), "run", ["reuses_id"], unique=False)
    op.create_index(op.f("ix_run_runner_id"), "run", ["runner_id"], unique=False)
    op.create_index(op.f("ix_run_started_by_id"), "run", ["started_by_id"], unique=False)
    op.create_index(op.f("ix_run_version_id"), "run", ["version_id"], unique=False)


def _make_files_of_runs() -> None:
    op.create_table(
        "run_input",
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("path", sa.Text(collation="C"), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.LargeBinary(), nullable=False),
        sa.Column("blob_id", sa.Uuid(), nullable=True),
        sa.Column("file_id", sa.Uuid(), nullable=True),
        sa.ForeignKeyConstraint(["blob_id"], ["blob.id"], name=op.f("fk_run_input_blob_id_blob"), ondelete="SET NULL"),
        sa.ForeignKeyConstraint(["file_id"], ["file.id"], name=op.f("fk_run_input_file_id_file"), ondelete="SET NULL"),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_run_input_run_id_run"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("run_id", "path", name=op.f("pk_run_input")),
    )
    op.create_index(op.f("ix_run_input_blob_id"), "run_input", ["blob_id"], unique=False)
    op.create_index(op.f("ix_run_input_file_id"), "run_input", ["file_id"], unique=False)
    op.create_table(
        "run_artifact",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("path", sa.Text(collation="C"), nullable=False),
        sa.Column("blob_id", sa.Uuid(), nullable=False),
        sa.Column("file_id", sa.Uuid(), nullable=True),
        sa.Column("made_from", sa.ARRAY(sa.Text()), nullable=True),
        sa.ForeignKeyConstraint(["blob_id"], ["blob.id"], name=op.f("fk_run_artifact_blob_id_blob")),
        sa.ForeignKeyConstraint(
            ["file_id"], ["file.id"], name=op.f("fk_run_artifact_file_id_file"), ondelete="SET NULL"
        ),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_run_artifact_run_id_run"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_run_artifact")),
        sa.UniqueConstraint("run_id", "path", name=op.f("uq_run_artifact_run_id_path")),
    )
    op.create_index(op.f("ix_run_artifact_blob_id"), "run_artifact", ["blob_id"], unique=False)
    op.create_index(op.f("ix_run_artifact_file_id"), "run_artifact", ["file_id"], unique=False)
    op.create_table(
        "log_chunk",
        sa.Column("key", sa.Text(), nullable=False),
        sa.Column("store_id", sa.Text(), server_default="main", nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=True),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("offset_bytes", sa.BigInteger(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("kept_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_log_chunk_run_id_run"), ondelete="SET NULL"),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_log_chunk")),
    )
    op.create_index("ix_log_chunk_run_id", "log_chunk", ["run_id", "attempt", "offset_bytes"], unique=False)


def _make_words_of_runs() -> None:
    op.create_table(
        "run_finding",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("severity", sa.Text(), nullable=False),
        sa.Column("code", sa.Text(collation="C"), nullable=False),
        sa.Column("message", sa.Text(), nullable=False),
        sa.Column("file", sa.Text(), nullable=True),
        sa.Column("topic", sa.Text(), nullable=True),
        sa.Column("time_ns", sa.BigInteger(), nullable=True),
        sa.CheckConstraint("severity IN ('info', 'warning', 'error')", name=op.f("ck_run_finding_severity")),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_run_finding_run_id_run"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_run_finding")),
    )
    op.create_index("ix_run_finding_code", "run_finding", ["code", "id"], unique=False)
    op.create_index("ix_run_finding_run_id", "run_finding", ["run_id", "id"], unique=False)
    op.create_table(
        "run_metric",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.Column("value", sa.Double(), nullable=False),
        sa.Column("unit", sa.Text(), nullable=True),
        sa.Column("file", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_run_metric_run_id_run"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_run_metric")),
    )
    op.create_index("ix_run_metric_name", "run_metric", ["name", "id"], unique=False)
    op.create_index("ix_run_metric_run_id", "run_metric", ["run_id", "id"], unique=False)


def _open_others_to_runs() -> None:
    op.add_column("token", sa.Column("run_id", sa.Uuid(), nullable=True))
    op.add_column("token", sa.Column("most", sa.Text(), nullable=True))
    op.create_index(op.f("ix_token_run_id"), "token", ["run_id"], unique=False)
    op.create_foreign_key(op.f("fk_token_run_id_run"), "token", "run", ["run_id"], ["id"], ondelete="SET NULL")
    op.add_column("upload", sa.Column("run_id", sa.Uuid(), nullable=True))
    op.create_index(op.f("ix_upload_run_id"), "upload", ["run_id"], unique=False)
    op.create_index(
        "uq_upload_run_path_active",
        "upload",
        ["run_id", "path"],
        unique=True,
        postgresql_where=sa.text("state IN ('open', 'completing') AND run_id IS NOT NULL"),
    )
    op.create_foreign_key(op.f("fk_upload_run_id_run"), "upload", "run", ["run_id"], ["id"])
    op.drop_index("uq_upload_path_key_active", "upload")
    op.create_index(
        "uq_upload_path_key_active",
        "upload",
        ["mission_id", "path_key"],
        unique=True,
        postgresql_where=sa.text("state IN ('open', 'completing') AND run_id IS NULL"),
    )
    op.drop_constraint("ck_file_origin", "file")
    op.create_check_constraint(op.f("ck_file_origin"), "file", "origin IN ('upload', 'link', 'run')")
    op.drop_constraint("ck_token_kind", "token")
    op.create_check_constraint(op.f("ck_token_kind"), "token", "kind IN ('personal', 'robot', 'runner', 'run')")
    op.create_check_constraint(op.f("ck_token_most"), "token", "most IN ('READ', 'CREATE', 'WRITE', 'DELETE')")
    op.create_check_constraint(
        op.f("ck_token_run"), "token", "(run_id IS NULL OR kind = 'run') AND (kind = 'run') = (most IS NOT NULL)"
    )
