"""Files are found in the order of their time, the latest first, without all of them being sorted."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    begun = sa.text("coalesce(start_ns, '-9223372036854775808'::bigint)")
    op.create_index("ix_blob_begun", "blob", [begun], unique=False)
