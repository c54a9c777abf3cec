"""What the settings say of affiliation groups."""

import sqlalchemy as sa
from alembic import context, op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "affiliation",
        sa.Column("group_id", sa.Uuid(), nullable=False),
        sa.Column("default_level", sa.SmallInteger(), nullable=True),
        sa.CheckConstraint("default_level BETWEEN 1 AND 4", name=op.f("ck_affiliation_default_level")),
        sa.ForeignKeyConstraint(
            ["group_id"], ["access_group.id"], name=op.f("fk_affiliation_group_id_access_group"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("group_id", name=op.f("pk_affiliation")),
    )
    op.create_table(
        "affiliation_domain",
        sa.Column("domain", sa.Text(collation="C"), nullable=False),
        sa.Column("group_id", sa.Uuid(), nullable=False),
        sa.ForeignKeyConstraint(
            ["group_id"],
            ["affiliation.group_id"],
            name=op.f("fk_affiliation_domain_group_id_affiliation"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("domain", "group_id", name=op.f("pk_affiliation_domain")),
    )
    role = context.config.attributes["serving_role"]
    for table in ("affiliation", "affiliation_domain"):
        op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON {table} TO {role}")
