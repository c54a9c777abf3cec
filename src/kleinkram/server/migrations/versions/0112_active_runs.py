"""An index of active runs."""

from alembic import op

revision = "0112"
down_revision = "0111"
compatible_from = "0106"
locked_tables = ("run",)
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.execute(
        "CREATE INDEX ix_run_active ON run (created_at, id) INCLUDE (mission_id)"
        " WHERE state IN ('queued', 'preparing', 'running', 'collecting')"
    )
