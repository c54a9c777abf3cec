"""What is known of a recording as a whole: its content, why it is not whole, and what of it is lost."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("recording", sa.Column("content", sa.Text(), server_default="pending", nullable=False))
    op.add_column("recording", sa.Column("content_reason", sa.Text(), nullable=True))
    op.add_column("recording", sa.Column("lost", postgresql.JSONB(none_as_null=True), nullable=True))
    op.create_check_constraint(
        op.f("ck_recording_content"),
        "recording",
        "content IN ('pending', 'indexed', 'recovered', 'broken', 'opaque', 'error')",
    )
    # The worker derives them all anew, by and by.
    op.execute("UPDATE mission SET files_revision = files_revision + 1")
