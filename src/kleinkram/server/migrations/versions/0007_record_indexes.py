"""Finding events by token, by time, and those that took an admin's power."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index("ix_audit_event_token_id", "audit_event", ["token_id", "id"], unique=False)
    # Rows come in the order of their time, so a few bytes for each hundred pages find any of them.
    op.create_index("ix_audit_event_at", "audit_event", ["at"], unique=False, postgresql_using="brin")
    op.create_index(
        "ix_audit_event_as_admin", "audit_event", ["id"], unique=False, postgresql_where=sa.text("as_admin")
    )
