"""Words of paths are looked up apart in files that have a time and in those that have none.

So what is found among the latter alone, which come last in lists, need not be looked for among all others first. With 2
million files the migration takes less than half a minute, in which nothing is written. The index that held all goes
with the next revision: its lock is a stronger one, and whoever comes in between would wait for the other.
"""

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for name, condition in (("timed", "start_ns IS NOT NULL"), ("untimed", "start_ns IS NULL")):
        op.create_index(
            f"ix_file_words_{name}",
            "file",
            ["path_key"],
            postgresql_using="gin",
            postgresql_ops={"path_key": "gin_trgm_ops"},
            postgresql_where=sa.text(condition),
            postgresql_with={"gin_pending_list_limit": 256},
        )
