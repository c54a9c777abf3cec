"""What a scan finds: how far a blob was read, what of it is lost, and what else it says of itself."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("blob", sa.Column("depth", sa.Text(), nullable=True))
    op.add_column("blob", sa.Column("lost", postgresql.JSONB(none_as_null=True), nullable=True))
    op.add_column("blob", sa.Column("facts", postgresql.JSONB(), server_default="[]", nullable=False))
    op.create_check_constraint(op.f("ck_blob_depth"), "blob", "depth IN ('summary', 'scan')")
    # What was summarised before this version was read by its index.
    op.execute("UPDATE blob SET depth = 'summary' WHERE summarised_at IS NOT NULL AND content <> 'error'")
