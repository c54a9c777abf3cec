"""When a browser last proved who it is, second factors, and what a runner's token is bound to."""

import sqlalchemy as sa
from alembic import context, op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None
compatible_from = "0027"


def upgrade() -> None:
    now = sa.text("now()")
    op.add_column(
        "session", sa.Column("authenticated_at", sa.DateTime(timezone=True), server_default=now, nullable=False)
    )
    # Of a session that is there already, it is known when it began.
    op.execute("UPDATE session SET authenticated_at = created_at")
    op.add_column("oidc_login", sa.Column("renews", sa.Boolean(), server_default=sa.text("false"), nullable=False))

    op.add_column("token", sa.Column("runner_id", sa.Uuid(), nullable=True))
    op.add_column("token", sa.Column("runner_labels", sa.ARRAY(sa.Text()), nullable=True))
    op.create_check_constraint(
        op.f("ck_token_runner"), "token", "kind = 'runner' OR (runner_id IS NULL AND runner_labels IS NULL)"
    )
    op.create_index("ix_token_runner_id", "token", ["runner_id"], postgresql_where=sa.text("runner_id IS NOT NULL"))
    op.add_column("runner", sa.Column("token_id", sa.Uuid(), nullable=True))

    op.create_table(
        "totp",
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.Column("secret", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=now, nullable=False),
        sa.Column("confirmed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_step", sa.BigInteger(), server_default="0", nullable=False),
        sa.Column("failed_count", sa.Integer(), server_default="0", nullable=False),
        sa.Column("failed_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(["person_id"], ["person.id"], name=op.f("fk_totp_person_id_person")),
        sa.PrimaryKeyConstraint("person_id", name=op.f("pk_totp")),
    )
    op.create_table(
        "recovery_code",
        sa.Column("secret_sha256", sa.LargeBinary(), nullable=False),
        sa.Column("person_id", sa.Uuid(), nullable=False),
        sa.CheckConstraint("octet_length(secret_sha256) = 32", name=op.f("ck_recovery_code_secret_sha256")),
        sa.ForeignKeyConstraint(
            ["person_id"],
            ["totp.person_id"],
            name=op.f("fk_recovery_code_person_id_totp"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("secret_sha256", name=op.f("pk_recovery_code")),
    )
    op.create_index(op.f("ix_recovery_code_person_id"), "recovery_code", ["person_id"])
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON totp, recovery_code TO {role}")
