"""First schema: our tables, the queue's tables, and what the serving role may do with them."""

import sqlalchemy as sa
from alembic import context, op
from procrastinate.schema import SchemaManager
from sqlalchemy.dialects import postgresql

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "person",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_person")),
    )
    op.create_table(
        "store_probe",
        sa.Column("store_id", sa.Text(), nullable=False),
        sa.Column("checksum", sa.Text(), nullable=False),
        sa.Column("writes_once", sa.Boolean(), nullable=False),
        sa.Column("probed_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("checksum IN ('crc64nvme', 'sha256', 'md5')", name=op.f("ck_store_probe_checksum")),
        sa.PrimaryKeyConstraint("store_id", name=op.f("pk_store_probe")),
    )
    op.create_table(
        "blob",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("store_id", sa.Text(), server_default="main", nullable=False),
        sa.Column("key", sa.Text(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("crc64nvme", sa.LargeBinary(), nullable=True),
        sa.Column("sha256", sa.LargeBinary(), nullable=False),
        sa.Column("md5", sa.LargeBinary(), nullable=True),
        sa.Column("state", sa.Text(), server_default="stored", nullable=False),
        sa.Column("state_reason", sa.Text(), nullable=True),
        sa.Column("verified_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("uploaded_by_id", sa.Uuid(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("doomed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("content", sa.Text(), server_default="pending", nullable=False),
        sa.Column("content_reason", sa.Text(), nullable=True),
        sa.Column("format", sa.Text(), nullable=True),
        sa.Column("message_count", sa.BigInteger(), nullable=True),
        sa.Column("start_ns", sa.BigInteger(), nullable=True),
        sa.Column("end_ns", sa.BigInteger(), nullable=True),
        sa.Column("compression", sa.ARRAY(sa.Text()), server_default="{}", nullable=False),
        sa.Column("problems", postgresql.JSONB(astext_type=sa.Text()), server_default="[]", nullable=False),
        sa.Column("summarised_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "content IN ('pending', 'indexed', 'recovered', 'broken', 'opaque', 'error')", name=op.f("ck_blob_content")
        ),
        sa.CheckConstraint(
            "state <> 'verified' OR (md5 IS NOT NULL AND verified_at IS NOT NULL)", name=op.f("ck_blob_verified")
        ),
        sa.CheckConstraint("state IN ('stored', 'verified', 'lost', 'corrupt')", name=op.f("ck_blob_state")),
        sa.CheckConstraint("octet_length(crc64nvme) = 8", name=op.f("ck_blob_crc64nvme")),
        sa.CheckConstraint("octet_length(md5) = 16", name=op.f("ck_blob_md5")),
        sa.CheckConstraint("octet_length(sha256) = 32", name=op.f("ck_blob_sha256")),
        sa.CheckConstraint("size_bytes >= 0", name=op.f("ck_blob_size_bytes")),
        sa.CheckConstraint("start_ns <= end_ns", name=op.f("ck_blob_span")),
        sa.ForeignKeyConstraint(["uploaded_by_id"], ["person.id"], name=op.f("fk_blob_uploaded_by_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_blob")),
        sa.UniqueConstraint("store_id", "key", name=op.f("uq_blob_store_id_key")),
    )
    op.create_index(
        "ix_blob_doomed", "blob", ["doomed_at"], unique=False, postgresql_where=sa.text("doomed_at IS NOT NULL")
    )
    op.create_index(
        "ix_blob_size_sha256",
        "blob",
        ["size_bytes", "sha256"],
        unique=False,
        postgresql_where=sa.text("doomed_at IS NULL"),
    )
    op.create_index(
        "ix_blob_unverified",
        "blob",
        ["created_at"],
        unique=False,
        postgresql_where=sa.text("state = 'stored' AND doomed_at IS NULL"),
    )
    op.create_table(
        "project",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.Column("name_key", sa.Text(collation="C"), nullable=False),
        sa.Column("description", sa.Text(), server_default="", nullable=False),
        sa.Column("metadata_fields", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("created_by_id", sa.Uuid(), nullable=False),
        sa.Column("deleted_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("deleted_by_id", sa.Uuid(), nullable=True),
        sa.CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name=op.f("ck_project_deleted")),
        sa.CheckConstraint("char_length(name) BETWEEN 1 AND 128", name=op.f("ck_project_name_length")),
        sa.ForeignKeyConstraint(["created_by_id"], ["person.id"], name=op.f("fk_project_created_by_id_person")),
        sa.ForeignKeyConstraint(["deleted_by_id"], ["person.id"], name=op.f("fk_project_deleted_by_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_project")),
    )
    op.create_index("ix_project_created_at", "project", ["created_at", "id"], unique=False)
    op.create_index(
        "uq_project_name_key_live", "project", ["name_key"], unique=True, postgresql_where=sa.text("deleted_at IS NULL")
    )
    op.create_table(
        "token",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("secret_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("octet_length(secret_sha256) = 32", name=op.f("ck_token_secret_sha256")),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_token_person_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_token")),
        sa.UniqueConstraint("secret_sha256", name=op.f("uq_token_secret_sha256")),
    )
    op.create_index(op.f("ix_token_person_id"), "token", ["person_id"], unique=False)
    op.create_table(
        "audit_event",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("actor_id", sa.Uuid(), nullable=True),
        sa.Column("token_id", sa.Uuid(), nullable=True),
        sa.Column("operation", sa.Text(), nullable=False),
        sa.Column("noun", sa.Text(), nullable=False),
        sa.Column("noun_id", sa.Uuid(), nullable=True),
        sa.Column("noun_name", sa.Text(), nullable=False),
        sa.Column("project_id", sa.Uuid(), nullable=True),
        sa.Column("before", postgresql.JSONB(astext_type=sa.Text()), server_default="{}", nullable=False),
        sa.Column("after", postgresql.JSONB(astext_type=sa.Text()), server_default="{}", nullable=False),
        sa.Column("request_id", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["actor_id"], ["person.id"], name=op.f("fk_audit_event_actor_id_person")),
        sa.ForeignKeyConstraint(["token_id"], ["token.id"], name=op.f("fk_audit_event_token_id_token")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_event")),
    )
    op.create_index("ix_audit_event_noun_id", "audit_event", ["noun_id", "id"], unique=False)
    op.create_index("ix_audit_event_project_id", "audit_event", ["project_id", "id"], unique=False)
    op.create_table(
        "mission",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("project_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.Column("name_key", sa.Text(collation="C"), nullable=False),
        sa.Column("metadata", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.Column("metadata_yaml", sa.Text(), nullable=True),
        sa.Column("metadata_problems", postgresql.JSONB(astext_type=sa.Text()), server_default="[]", nullable=False),
        sa.Column("notes", sa.Text(), server_default="", nullable=False),
        sa.Column("completed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("start_ns", sa.BigInteger(), nullable=True),
        sa.Column("end_ns", sa.BigInteger(), nullable=True),
        sa.Column("files_revision", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("derived_revision", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("created_by_id", sa.Uuid(), nullable=False),
        sa.Column("deleted_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("deleted_by_id", sa.Uuid(), nullable=True),
        sa.CheckConstraint("jsonb_typeof(metadata) = 'object'", name=op.f("ck_mission_metadata")),
        sa.CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name=op.f("ck_mission_deleted")),
        sa.CheckConstraint(
            "(start_ns IS NULL) = (end_ns IS NULL) AND start_ns <= end_ns", name=op.f("ck_mission_span")
        ),
        sa.CheckConstraint("char_length(name) BETWEEN 1 AND 128", name=op.f("ck_mission_name_length")),
        sa.ForeignKeyConstraint(["created_by_id"], ["person.id"], name=op.f("fk_mission_created_by_id_person")),
        sa.ForeignKeyConstraint(["deleted_by_id"], ["person.id"], name=op.f("fk_mission_deleted_by_id_person")),
        sa.ForeignKeyConstraint(["project_id"], ["project.id"], name=op.f("fk_mission_project_id_project")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_mission")),
    )
    op.create_index("ix_mission_created_at", "mission", ["created_at", "id"], unique=False)
    op.create_index(
        "ix_mission_metadata",
        "mission",
        ["metadata"],
        unique=False,
        postgresql_using="gin",
        postgresql_ops={"metadata": "jsonb_path_ops"},
    )
    op.create_index("ix_mission_start_ns", "mission", ["start_ns", "id"], unique=False)
    op.create_index(
        "uq_mission_name_key_live",
        "mission",
        ["project_id", "name_key"],
        unique=True,
        postgresql_where=sa.text("deleted_at IS NULL"),
    )
    op.create_table(
        "topic",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("blob_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.Column("message_type", sa.Text(collation="C"), nullable=True),
        sa.Column("schema_name", sa.Text(), nullable=True),
        sa.Column("schema_encoding", sa.Text(), nullable=True),
        sa.Column("message_encoding", sa.Text(), nullable=True),
        sa.Column("count", sa.BigInteger(), nullable=True),
        sa.Column("first_ns", sa.BigInteger(), nullable=True),
        sa.Column("last_ns", sa.BigInteger(), nullable=True),
        sa.Column("rate_hz", sa.Double(), nullable=True),
        sa.Column("longest_gap_ns", sa.BigInteger(), nullable=True),
        sa.Column("head_gap_ns", sa.BigInteger(), nullable=True),
        sa.Column("tail_gap_ns", sa.BigInteger(), nullable=True),
        sa.Column("out_of_order_count", sa.BigInteger(), nullable=True),
        sa.Column("stored_bytes", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["blob_id"], ["blob.id"], name=op.f("fk_topic_blob_id_blob"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_topic")),
        sa.UniqueConstraint(
            "blob_id",
            "name",
            "message_type",
            name=op.f("uq_topic_blob_id_name_message_type"),
            postgresql_nulls_not_distinct=True,
        ),
    )
    op.create_index("ix_topic_message_type", "topic", ["message_type", "blob_id"], unique=False)
    op.create_index("ix_topic_name", "topic", ["name", "blob_id"], unique=False)
    op.create_table(
        "recording",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("mission_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("missing", sa.ARRAY(sa.Text()), server_default="{}", nullable=False),
        sa.Column("surplus", sa.ARRAY(sa.Text()), server_default="{}", nullable=False),
        sa.Column("problems", postgresql.JSONB(astext_type=sa.Text()), server_default="[]", nullable=False),
        sa.Column("message_count", sa.BigInteger(), nullable=True),
        sa.Column("start_ns", sa.BigInteger(), nullable=True),
        sa.Column("end_ns", sa.BigInteger(), nullable=True),
        sa.CheckConstraint("start_ns <= end_ns", name=op.f("ck_recording_span")),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_recording_mission_id_mission"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_recording")),
        sa.UniqueConstraint("mission_id", "name", "kind", name=op.f("uq_recording_mission_id_name_kind")),
    )
    op.create_table(
        "file",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("mission_id", sa.Uuid(), nullable=False),
        sa.Column("recording_id", sa.Uuid(), nullable=True),
        sa.Column("blob_id", sa.Uuid(), nullable=False),
        sa.Column("path", sa.Text(collation="C"), nullable=False),
        sa.Column("path_key", sa.Text(collation="C"), nullable=False),
        sa.Column("origin", sa.Text(), nullable=False),
        sa.Column("uploaded_by_id", sa.Uuid(), nullable=False),
        sa.Column("labels", sa.ARRAY(sa.Text()), server_default="{}", nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("deleted_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("deleted_by_id", sa.Uuid(), nullable=True),
        sa.CheckConstraint("origin IN ('upload', 'link')", name=op.f("ck_file_origin")),
        sa.CheckConstraint("(deleted_at IS NULL) = (deleted_by_id IS NULL)", name=op.f("ck_file_deleted")),
        sa.CheckConstraint("char_length(path) BETWEEN 1 AND 1024", name=op.f("ck_file_path_length")),
        sa.ForeignKeyConstraint(["blob_id"], ["blob.id"], name=op.f("fk_file_blob_id_blob")),
        sa.ForeignKeyConstraint(["deleted_by_id"], ["person.id"], name=op.f("fk_file_deleted_by_id_person")),
        sa.ForeignKeyConstraint(["mission_id"], ["mission.id"], name=op.f("fk_file_mission_id_mission")),
        sa.ForeignKeyConstraint(
            ["recording_id"], ["recording.id"], name=op.f("fk_file_recording_id_recording"), ondelete="SET NULL"
        ),
        sa.ForeignKeyConstraint(["uploaded_by_id"], ["person.id"], name=op.f("fk_file_uploaded_by_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_file")),
    )
    op.create_index(op.f("ix_file_blob_id"), "file", ["blob_id"], unique=False)
    op.create_index("ix_file_created_at", "file", ["created_at", "id"], unique=False)
    op.create_index(
        "ix_file_deleted_at", "file", ["deleted_at"], unique=False, postgresql_where=sa.text("deleted_at IS NOT NULL")
    )
    op.create_index("ix_file_labels", "file", ["labels"], unique=False, postgresql_using="gin")
    op.create_index("ix_file_path", "file", ["mission_id", "path", "id"], unique=False)
    op.create_index(op.f("ix_file_recording_id"), "file", ["recording_id"], unique=False)
    op.create_index(
        "uq_file_path_key_live",
        "file",
        ["mission_id", "path_key"],
        unique=True,
        postgresql_where=sa.text("deleted_at IS NULL"),
    )
    op.create_table(
        "upload",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("mission_id", sa.Uuid(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("path", sa.Text(collation="C"), nullable=False),
        sa.Column("path_key", sa.Text(collation="C"), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("part_size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("checksum", sa.Text(), nullable=False),
        sa.Column("store_id", sa.Text(), server_default="main", nullable=False),
        sa.Column("key", sa.Text(), nullable=False),
        sa.Column("multipart_id", sa.Text(), nullable=True),
        sa.Column("signed_checksum", sa.Text(), nullable=True),
        sa.Column("state", sa.Text(), server_default="open", nullable=False),
        sa.Column("sha256", sa.LargeBinary(), nullable=True),
        sa.Column("crc64nvme", sa.LargeBinary(), nullable=True),
        sa.Column("file_id", sa.Uuid(), nullable=True),
        sa.Column("failure", sa.Text(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("lease_ends_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("completing_since", sa.DateTime(timezone=True), nullable=True),
        sa.Column("cleaned_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("checksum IN ('crc64nvme', 'sha256', 'md5')", name=op.f("ck_upload_checksum")),
        sa.CheckConstraint(
            "state <> 'completing' OR (sha256 IS NOT NULL AND crc64nvme IS NOT NULL AND completing_since IS NOT NULL)",
            name=op.f("ck_upload_completing"),
        ),
        sa.CheckConstraint(
            "state IN ('open', 'completing', 'done', 'aborted', 'expired')", name=op.f("ck_upload_state")
        ),
        sa.CheckConstraint("size_bytes >= 0 AND part_size_bytes > 0", name=op.f("ck_upload_sizes")),
        sa.ForeignKeyConstraint(["file_id"], ["file.id"], name=op.f("fk_upload_file_id_file"), ondelete="SET NULL"),
        sa.ForeignKeyConstraint(["mission_id"], ["mission.id"], name=op.f("fk_upload_mission_id_mission")),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_upload_person_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_upload")),
        sa.UniqueConstraint("key", name=op.f("uq_upload_key")),
    )
    op.create_index(
        "ix_upload_expires_at",
        "upload",
        ["expires_at"],
        unique=False,
        postgresql_where=sa.text("state IN ('open', 'completing')"),
    )
    op.create_index(
        "ix_upload_file_id", "upload", ["file_id"], unique=False, postgresql_where=sa.text("file_id IS NOT NULL")
    )
    op.create_index("ix_upload_mission_id", "upload", ["mission_id"], unique=False)
    op.create_index(
        "ix_upload_uncleaned", "upload", ["created_at"], unique=False, postgresql_where=sa.text("cleaned_at IS NULL")
    )
    op.create_index(
        "uq_upload_path_key_active",
        "upload",
        ["mission_id", "path_key"],
        unique=True,
        postgresql_where=sa.text("state IN ('open', 'completing')"),
    )
    _create_queue()
    _grant(context.config.attributes["serving_role"])


def _create_queue() -> None:
    # The pinned minor version's schema; a newer procrastinate comes with a migration of its own.
    cursor = op.get_bind().connection.cursor()
    cursor.execute(SchemaManager.get_schema())
    # Ours on their table: asked under the lock on a mission, so it has to be quick.
    op.execute(
        "CREATE INDEX ix_procrastinate_jobs_ref ON procrastinate_jobs (task_name, (args ->> 'ref'))"
        " WHERE status IN ('todo', 'doing')"
    )


def _grant(role: str) -> None:
    op.execute(f"GRANT USAGE ON SCHEMA public TO {role}")
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON ALL TABLES IN SCHEMA public TO {role}")
    op.execute(f"GRANT USAGE, SELECT ON ALL SEQUENCES IN SCHEMA public TO {role}")
    op.execute(f"GRANT EXECUTE ON ALL FUNCTIONS IN SCHEMA public TO {role}")
    # The record can be added to and read; what was written stays.
    op.execute(f"REVOKE UPDATE, DELETE ON audit_event FROM {role}")
    op.execute(f"REVOKE INSERT, UPDATE, DELETE ON alembic_version FROM {role}")
