"""Files that are damaged, lost or not well read are found in an index of these alone.

Home lists them for whoever comes, out of all that they see: at 2 million files it took a second. The migration takes a
few seconds then, in which no file is completed.
"""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None


def upgrade() -> None:
    ailing = sa.text("state IN ('corrupt', 'lost') OR content IN ('broken', 'recovered', 'error')")
    op.create_index("ix_blob_ailing", "blob", ["id"], postgresql_where=ailing)
