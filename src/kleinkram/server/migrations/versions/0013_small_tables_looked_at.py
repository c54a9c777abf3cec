"""Small tables are looked at by the planner as soon as they change.

By default PostgreSQL waits for fifty rows. Until then it takes a project that is not in the trash for one in two
hundred, and so plans to look up one by one what is all of the files.
"""

from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None

_TABLES = ("project", "mission", "person", "access_group", "membership", "access_grant")


def upgrade() -> None:
    for table in _TABLES:
        op.execute(f"ALTER TABLE {table} SET (autovacuum_analyze_threshold = 0)")
