"""Scrubs, since when a blob is lost or corrupt, and which was verified longest ago."""

import sqlalchemy as sa
from alembic import context, op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("blob", sa.Column("damaged_at", sa.DateTime(timezone=True), nullable=True))
    # Since when nobody wrote down: since now at the latest.
    op.execute("UPDATE blob SET damaged_at = now() WHERE state IN ('lost', 'corrupt')")
    op.create_index(
        "ix_blob_verified_at",
        "blob",
        ["verified_at"],
        unique=False,
        postgresql_where=sa.text("state = 'verified' AND doomed_at IS NULL"),
    )
    op.create_index(
        "ix_blob_key", "blob", ["store_id", "key"], unique=False, postgresql_ops={"key": "text_pattern_ops"}
    )
    op.create_table(
        "scrub",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("store_id", sa.Text(), nullable=False),
        sa.Column("asked_by_id", sa.Uuid(), nullable=True),
        sa.Column("believes", sa.Boolean(), server_default=sa.text("false"), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("seen_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("stopped", sa.Text(), nullable=True),
        *(
            sa.Column(name, sa.BigInteger(), server_default="0", nullable=False)
            for name in ("compared", "compared_bytes", "lost", "corrupt", "found", "unknown")
        ),
        sa.CheckConstraint("stopped IS NULL OR ended_at IS NOT NULL", name=op.f("ck_scrub_stopped")),
        sa.ForeignKeyConstraint(["asked_by_id"], ["person.id"], name=op.f("fk_scrub_asked_by_id_person")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_scrub")),
    )
    op.create_index("ix_scrub_created_at", "scrub", ["store_id", "created_at"], unique=False)
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON scrub TO {role}")
