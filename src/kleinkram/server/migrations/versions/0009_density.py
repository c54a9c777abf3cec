"""How densely messages lie in time, and the topics of missions, all recordings together."""

import sqlalchemy as sa
from alembic import context, op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("topic", sa.Column("density", sa.LargeBinary(), nullable=True))
    op.create_table(
        "mission_topics",
        sa.Column("mission_id", sa.Uuid(), nullable=False),
        sa.Column("revision", sa.BigInteger(), nullable=False),
        sa.Column("recording_ids", sa.ARRAY(sa.Uuid()), nullable=False),
        sa.Column("bin_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["mission_id"], ["mission.id"], name=op.f("fk_mission_topics_mission_id_mission"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("mission_id", name=op.f("pk_mission_topics")),
    )
    op.create_table(
        "mission_topic",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("mission_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.Column("message_type", sa.Text(collation="C"), nullable=True),
        sa.Column("count", sa.BigInteger(), nullable=True),
        sa.Column("file_count", sa.Integer(), nullable=False),
        sa.Column("recording_count", sa.Integer(), nullable=False),
        sa.Column("places", sa.ARRAY(sa.Integer()), nullable=False),
        sa.Column("first_ns", sa.BigInteger(), nullable=True),
        sa.Column("last_ns", sa.BigInteger(), nullable=True),
        sa.Column("rate_hz", sa.Double(), nullable=True),
        sa.Column("longest_gap_ns", sa.BigInteger(), nullable=True),
        sa.Column("stored_bytes", sa.BigInteger(), nullable=True),
        sa.Column("density", sa.LargeBinary(), nullable=True),
        sa.ForeignKeyConstraint(
            ["mission_id"],
            ["mission_topics.mission_id"],
            name=op.f("fk_mission_topic_mission_id_mission_topics"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_mission_topic")),
        sa.UniqueConstraint(
            "mission_id",
            "name",
            "message_type",
            name=op.f("uq_mission_topic_mission_id_name_message_type"),
            postgresql_nulls_not_distinct=True,
        ),
    )
    role = context.config.attributes["serving_role"]
    for table in ("mission_topics", "mission_topic"):
        op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON {table} TO {role}")
