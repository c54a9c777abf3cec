"""Jobs and runs store the request and the trace that caused them."""

from alembic import op

revision = "0109"
down_revision = "0108"
# Programs of that schema neither write nor read the new columns.
compatible_from = "0106"
branch_labels = None
depends_on = None

# Outside of the transaction that sets it, the setting is unknown or empty.
_STATEMENTS = """
ALTER TABLE procrastinate_jobs
    ADD COLUMN origin jsonb DEFAULT nullif(current_setting('kleinkram.job_origin', true), '')::jsonb;
ALTER TABLE run ADD COLUMN traceparent text;
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
