"""Signing in."""

import sqlalchemy as sa
from alembic import context, op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "identity",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("issuer", sa.Text(), nullable=False),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column("email", sa.Text(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("last_used_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_identity_person_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_identity")),
        sa.UniqueConstraint("issuer", "subject", name=op.f("uq_identity_issuer_subject")),
    )
    op.create_index(op.f("ix_identity_person_id"), "identity", ["person_id"], unique=False)
    op.create_table(
        "password",
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("hash", sa.Text(), nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("hash LIKE '$argon2id$%'", name=op.f("ck_password_hash")),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_password_person_id_person")),
        sa.PrimaryKeyConstraint("person_id", name=op.f("pk_password")),
    )
    op.create_table(
        "one_time_code",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("purpose", sa.Text(), nullable=False),
        sa.Column("secret_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=True),
        sa.Column("email", sa.Text(), nullable=True),
        sa.Column("name", sa.Text(), nullable=True),
        sa.Column("created_by_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("used_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "purpose IN ('claim', 'owner', 'invitation', 'reset')", name=op.f("ck_one_time_code_purpose")
        ),
        sa.CheckConstraint("octet_length(secret_sha256) = 32", name=op.f("ck_one_time_code_secret_sha256")),
        sa.CheckConstraint(
            "(purpose IN ('owner', 'reset')) = (person_id IS NOT NULL)", name=op.f("ck_one_time_code_person")
        ),
        sa.CheckConstraint("(purpose = 'invitation') = (email IS NOT NULL)", name=op.f("ck_one_time_code_email")),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_one_time_code_person_id_person")),
        sa.ForeignKeyConstraint(["created_by_id"], ["person.id"], name=op.f("fk_one_time_code_created_by_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_one_time_code")),
        sa.UniqueConstraint("secret_sha256", name=op.f("uq_one_time_code_secret_sha256")),
    )
    op.create_index(op.f("ix_one_time_code_person_id"), "one_time_code", ["person_id"], unique=False)
    op.create_table(
        "oidc_login",
        sa.Column("state_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("provider", sa.Text(), nullable=False),
        sa.Column("nonce", sa.Text(), nullable=False),
        sa.Column("code_verifier", sa.Text(), nullable=False),
        sa.Column("browser_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("session_id", sa.Uuid(), nullable=True),
        sa.Column("return_to", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "octet_length(state_sha256) = 32 AND octet_length(browser_sha256) = 32", name=op.f("ck_oidc_login_sha256")
        ),
        sa.ForeignKeyConstraint(["session_id"], ["session.id"], name=op.f("fk_oidc_login_session_id_session")),
        sa.PrimaryKeyConstraint("state_sha256", name=op.f("pk_oidc_login")),
    )
    op.create_index(op.f("ix_oidc_login_expires_at"), "oidc_login", ["expires_at"], unique=False)
    _login_request()
    op.create_table(
        "rate_count",
        sa.Column("key", sa.Text(collation="C"), nullable=False),
        sa.Column("window_start", sa.DateTime(timezone=True), nullable=False),
        sa.Column("count", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("key", "window_start", name=op.f("pk_rate_count")),
        prefixes=["UNLOGGED"],
    )
    op.create_index("ix_rate_count_window_start", "rate_count", ["window_start"], unique=False)
    role = context.config.attributes["serving_role"]
    for table in ("identity", "password", "one_time_code", "oidc_login", "login_request", "rate_count"):
        op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON {table} TO {role}")


def _login_request() -> None:
    op.create_table(
        "login_request",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("secret_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("label", sa.Text(collation="C"), nullable=False),
        sa.Column("address", sa.Text(), nullable=True),
        sa.Column("user_code", sa.Text(), nullable=True),
        sa.Column("code_challenge", sa.Text(), nullable=True),
        sa.Column("port", sa.Integer(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("polled_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("approved_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("approved_by_id", sa.Uuid(), nullable=True),
        sa.Column("approved_session_id", sa.Uuid(), nullable=True),
        sa.Column("denied_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("redeemed_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("kind IN ('loopback', 'device')", name=op.f("ck_login_request_kind")),
        sa.CheckConstraint("octet_length(secret_sha256) = 32", name=op.f("ck_login_request_secret_sha256")),
        sa.CheckConstraint("(kind = 'device') = (user_code IS NOT NULL)", name=op.f("ck_login_request_user_code")),
        sa.CheckConstraint(
            "(kind = 'loopback') = (code_challenge IS NOT NULL AND port IS NOT NULL)",
            name=op.f("ck_login_request_loopback"),
        ),
        sa.CheckConstraint("(approved_at IS NULL) = (approved_by_id IS NULL)", name=op.f("ck_login_request_approved")),
        sa.CheckConstraint("approved_at IS NULL OR denied_at IS NULL", name=op.f("ck_login_request_decided")),
        sa.CheckConstraint("redeemed_at IS NULL OR approved_at IS NOT NULL", name=op.f("ck_login_request_redeemed")),
        sa.ForeignKeyConstraint(["approved_by_id"], ["person.id"], name=op.f("fk_login_request_approved_by_id_person")),
        sa.ForeignKeyConstraint(
            ["approved_session_id"], ["session.id"], name=op.f("fk_login_request_approved_session_id_session")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_login_request")),
        sa.UniqueConstraint("secret_sha256", name=op.f("uq_login_request_secret_sha256")),
    )
    op.create_index(op.f("ix_login_request_expires_at"), "login_request", ["expires_at"], unique=False)
    op.create_index(
        "uq_login_request_user_code",
        "login_request",
        ["user_code"],
        unique=True,
        postgresql_where=sa.text("redeemed_at IS NULL AND denied_at IS NULL"),
    )
