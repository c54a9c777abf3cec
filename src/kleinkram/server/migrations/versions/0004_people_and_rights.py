"""People and rights."""

import uuid

import sqlalchemy as sa
from alembic import context, op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

_ADMINS = uuid.UUID("61646d69-6e73-4000-8000-000000000001")


def upgrade() -> None:
    op.create_table(
        "access_group",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.Column("name_key", sa.Text(collation="C"), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("created_by_id", sa.Uuid(), nullable=True),
        sa.CheckConstraint("(kind = 'person') = (person_id IS NOT NULL)", name=op.f("ck_access_group_person")),
        sa.CheckConstraint(
            "kind IN ('person', 'email', 'custom', 'affiliation', 'admins')", name=op.f("ck_access_group_kind")
        ),
        sa.ForeignKeyConstraint(["created_by_id"], ["person.id"], name=op.f("fk_access_group_created_by_id_person")),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_access_group_person_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_access_group")),
        sa.UniqueConstraint("person_id", name=op.f("uq_access_group_person_id")),
    )
    op.create_index(
        "uq_access_group_email", "access_group", ["name_key"], unique=True, postgresql_where=sa.text("kind = 'email'")
    )
    op.create_index(
        "uq_access_group_name",
        "access_group",
        ["name_key"],
        unique=True,
        postgresql_where=sa.text("kind IN ('custom', 'affiliation', 'admins')"),
    )
    op.create_table(
        "person_email",
        sa.Column("email_key", sa.Text(collation="C"), nullable=False),
        sa.Column("email", sa.Text(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("verified_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("verified_by", sa.Text(), nullable=True),
        sa.CheckConstraint("(verified_at IS NULL) = (verified_by IS NULL)", name=op.f("ck_person_email_verified")),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_person_email_person_id_person")),
        sa.PrimaryKeyConstraint("email_key", name=op.f("pk_person_email")),
    )
    op.create_index(op.f("ix_person_email_person_id"), "person_email", ["person_id"], unique=False)
    op.create_table(
        "session",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("secret_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("way", sa.Text(), nullable=False),
        sa.Column("address", sa.Text(), nullable=True),
        sa.Column("user_agent", sa.Text(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("last_used_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("octet_length(secret_sha256) = 32", name=op.f("ck_session_secret_sha256")),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_session_person_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_session")),
        sa.UniqueConstraint("secret_sha256", name=op.f("uq_session_secret_sha256")),
    )
    op.create_index(op.f("ix_session_person_id"), "session", ["person_id"], unique=False)
    op.create_table(
        "membership",
        sa.Column("group_id", sa.Uuid(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("is_editor", sa.Boolean(), server_default=sa.text("false"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("added_by_id", sa.Uuid(), nullable=True),
        sa.ForeignKeyConstraint(["added_by_id"], ["person.id"], name=op.f("fk_membership_added_by_id_person")),
        sa.ForeignKeyConstraint(
            ["group_id"], ["access_group.id"], name=op.f("fk_membership_group_id_access_group"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_membership_person_id_person")),
        sa.PrimaryKeyConstraint("group_id", "person_id", name=op.f("pk_membership")),
    )
    op.create_index("ix_membership_person_id", "membership", ["person_id", "group_id"], unique=False)
    op.create_table(
        "access_grant",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("group_id", sa.Uuid(), nullable=False),
        sa.Column("project_id", sa.Uuid(), nullable=True),
        sa.Column("mission_id", sa.Uuid(), nullable=True),
        sa.Column("level", sa.SmallInteger(), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("granted_by_id", sa.Uuid(), nullable=True),
        sa.CheckConstraint("level BETWEEN 1 AND 4", name=op.f("ck_access_grant_level")),
        sa.CheckConstraint("num_nonnulls(project_id, mission_id) = 1", name=op.f("ck_access_grant_place")),
        sa.ForeignKeyConstraint(["granted_by_id"], ["person.id"], name=op.f("fk_access_grant_granted_by_id_person")),
        sa.ForeignKeyConstraint(
            ["group_id"], ["access_group.id"], name=op.f("fk_access_grant_group_id_access_group"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_access_grant_mission_id_mission"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["project_id"], ["project.id"], name=op.f("fk_access_grant_project_id_project"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_access_grant")),
    )
    op.create_index("ix_access_grant_group_id", "access_grant", ["group_id"], unique=False)
    op.create_index("uq_access_grant_mission", "access_grant", ["mission_id", "group_id"], unique=True)
    op.create_index("uq_access_grant_project", "access_grant", ["project_id", "group_id"], unique=True)
    op.create_table(
        "share",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("mission_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("is_whole", sa.Boolean(), nullable=False),
        sa.Column("prefix", sa.Text(), nullable=False),
        sa.Column("secret_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("created_by_id", sa.Uuid(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("download_count", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("download_bytes", sa.BigInteger(), server_default="0", nullable=False),
        sa.CheckConstraint("octet_length(secret_sha256) = 32", name=op.f("ck_share_secret_sha256")),
        sa.ForeignKeyConstraint(["created_by_id"], ["person.id"], name=op.f("fk_share_created_by_id_person")),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_share_mission_id_mission"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_share")),
        sa.UniqueConstraint("secret_sha256", name=op.f("uq_share_secret_sha256")),
    )
    op.create_index(op.f("ix_share_mission_id"), "share", ["mission_id"], unique=False)
    op.create_table(
        "token_limit",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("token_id", sa.Uuid(), nullable=False),
        sa.Column("project_id", sa.Uuid(), nullable=True),
        sa.Column("mission_id", sa.Uuid(), nullable=True),
        sa.CheckConstraint("num_nonnulls(project_id, mission_id) = 1", name=op.f("ck_token_limit_place")),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_token_limit_mission_id_mission"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["project_id"], ["project.id"], name=op.f("fk_token_limit_project_id_project"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["token_id"], ["token.id"], name=op.f("fk_token_limit_token_id_token"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_token_limit")),
    )
    op.create_index("ix_token_limit_token_id", "token_limit", ["token_id"], unique=False)
    op.create_table(
        "share_file",
        sa.Column("share_id", sa.Uuid(), nullable=False),
        sa.Column("file_id", sa.Uuid(), nullable=False),
        sa.ForeignKeyConstraint(["file_id"], ["file.id"], name=op.f("fk_share_file_file_id_file"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(
            ["share_id"], ["share.id"], name=op.f("fk_share_file_share_id_share"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("share_id", "file_id", name=op.f("pk_share_file")),
    )
    op.create_index(op.f("ix_share_file_file_id"), "share_file", ["file_id"], unique=False)
    op.add_column("audit_event", sa.Column("session_id", sa.Uuid(), nullable=True))
    op.add_column("audit_event", sa.Column("share_id", sa.Uuid(), nullable=True))
    op.add_column("audit_event", sa.Column("address", sa.Text(), nullable=True))
    op.add_column("audit_event", sa.Column("as_admin", sa.Boolean(), server_default=sa.text("false"), nullable=False))
    op.add_column("audit_event", sa.Column("mission_id", sa.Uuid(), nullable=True))
    op.create_index("ix_audit_event_actor_id", "audit_event", ["actor_id", "id"], unique=False)
    op.create_index("ix_audit_event_mission_id", "audit_event", ["mission_id", "id"], unique=False)
    op.create_foreign_key(op.f("fk_audit_event_session_id_session"), "audit_event", "session", ["session_id"], ["id"])
    op.add_column("person", sa.Column("deactivated_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("project", sa.Column("is_public", sa.Boolean(), server_default=sa.text("false"), nullable=False))
    op.add_column("project", sa.Column("licence", sa.Text(), server_default="", nullable=False))
    op.add_column("project", sa.Column("citation", sa.Text(), server_default="", nullable=False))
    op.add_column("project", sa.Column("quota_bytes", sa.BigInteger(), nullable=True))
    op.add_column("project", sa.Column("quota_files", sa.BigInteger(), nullable=True))
    op.create_index("ix_project_public", "project", ["id"], unique=False, postgresql_where=sa.text("is_public"))
    op.add_column("token", sa.Column("kind", sa.Text(), server_default="personal", nullable=False))
    op.add_column("token", sa.Column("prefix", sa.Text(), server_default="", nullable=False))
    op.add_column("token", sa.Column("scopes", sa.ARRAY(sa.Text()), nullable=True))
    # Those that were made before there were scopes were good for everything.
    op.execute("UPDATE token SET scopes = '{admin}'")
    op.alter_column("token", "scopes", nullable=False)
    op.add_column("token", sa.Column("is_limited", sa.Boolean(), server_default=sa.text("false"), nullable=False))
    op.add_column("token", sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("token", sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True))
    op.create_check_constraint(
        op.f("ck_token_scopes"), "token", "scopes <@ ARRAY['read', 'upload', 'write', 'run', 'admin']::text[]"
    )
    op.create_check_constraint(op.f("ck_token_kind"), "token", "kind IN ('personal', 'robot', 'runner')")
    op.create_check_constraint(op.f("ck_project_quota"), "project", "quota_bytes >= 0 AND quota_files >= 0")
    _fill()
    role = context.config.attributes["serving_role"]
    for table in ("access_group", "membership", "access_grant", "person_email", "session", "share", "share_file"):
        op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON {table} TO {role}")
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON token_limit TO {role}")


def _fill() -> None:
    admins = sa.literal(_ADMINS, sa.Uuid())
    group = sa.table("access_group", *(sa.column(name) for name in ("id", "kind", "name", "name_key", "person_id")))
    member = sa.table("membership", sa.column("group_id"), sa.column("person_id"))
    person = sa.table("person", sa.column("id"), sa.column("name"))
    op.execute(
        sa.insert(group).from_select(
            ["id", "kind", "name", "name_key"], sa.select(admins, *(sa.literal("admins"),) * 3)
        )
    )
    own = sa.select(
        sa.func.gen_random_uuid(), sa.literal("person"), person.c.name, sa.func.lower(person.c.name), person.c.id
    )
    op.execute(sa.insert(group).from_select(["id", "kind", "name", "name_key", "person_id"], own))
    everybody = sa.select(group.c.id, group.c.person_id).where(group.c.kind == "person")
    op.execute(
        sa.insert(member).from_select(["group_id", "person_id"], everybody.union_all(sa.select(admins, person.c.id)))
    )
    op.execute(
        "INSERT INTO access_grant (id, group_id, project_id, level)"
        " SELECT gen_random_uuid(), access_group.id, project.id, 4"
        " FROM project JOIN access_group ON access_group.person_id = project.created_by_id"
    )
