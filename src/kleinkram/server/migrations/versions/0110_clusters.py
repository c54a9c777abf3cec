"""Runs have priorities, isolation and placements, and may be recorded; leases have lengths, projects an isolation."""

from alembic import op

revision = "0110"
down_revision = "0109"
# Programs of that schema neither write nor read the new columns.
compatible_from = "0106"
locked_tables = ("project", "run", "runner")
branch_labels = None
depends_on = None

_STATEMENTS = """
ALTER TABLE project ADD COLUMN isolation text DEFAULT 'container' NOT NULL
    CONSTRAINT ck_project_isolation CHECK (isolation IN ('container', 'namespaces', 'none'));
ALTER TABLE run ADD COLUMN priority text DEFAULT 'normal' NOT NULL
    CONSTRAINT ck_run_priority CHECK (priority IN ('low', 'normal', 'high'));
ALTER TABLE run ADD COLUMN isolation text
    CONSTRAINT ck_run_isolation CHECK (isolation IN ('container', 'namespaces', 'none'));
ALTER TABLE run ADD COLUMN placement jsonb;
ALTER TABLE run ADD COLUMN is_recorded boolean DEFAULT false NOT NULL;
CREATE INDEX ix_run_job_id ON run ((placement ->> 'job_id')) WHERE placement IS NOT NULL;
CREATE INDEX ix_run_node ON run ((placement ->> 'node'), created_at, id) WHERE placement IS NOT NULL;
ALTER TABLE runner ADD COLUMN lease_s integer DEFAULT 60 NOT NULL;
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
