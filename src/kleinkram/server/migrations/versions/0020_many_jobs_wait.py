"""The next job is found as quickly among twenty thousand that wait as among two.

What fetches it asks for each waiting job whether another holds its lock, and plans that while the queue is empty, as
it is most of the time: it then read all jobs for each job (250 ms of the database at 2000). Now it looks into an
index, in the order of the one by priority.
"""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index(
        "ix_procrastinate_jobs_lock",
        "procrastinate_jobs",
        ["lock"],
        postgresql_where=sa.text("status IN ('todo', 'doing')"),
    )
    op.execute("ALTER FUNCTION procrastinate_fetch_job_v2 (varchar[], bigint) SET enable_sort = off")
