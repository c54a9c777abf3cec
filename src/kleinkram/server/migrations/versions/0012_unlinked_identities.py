"""Identities that were unlinked."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("identity", sa.Column("unlinked_at", sa.DateTime(timezone=True), nullable=True))
