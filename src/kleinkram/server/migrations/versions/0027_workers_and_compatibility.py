"""Worker processes report when they were last alive, and the schema names the oldest program that works on it."""

import sqlalchemy as sa
from alembic import context, op

revision = "0027"
down_revision = "0026"
branch_labels = None
depends_on = None
compatible_from = "0027"


def upgrade() -> None:
    op.add_column("alembic_version", sa.Column("compatible_from", sa.Text(), nullable=True))
    op.create_table(
        "worker_process",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("host", sa.Text(), nullable=False),
        sa.Column("pid", sa.Integer(), nullable=False),
        sa.Column("version", sa.Text(), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("seen_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_worker_process")),
    )
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON worker_process TO {context.config.attributes['serving_role']}")
