"""Runs have a priority and a placement, and may be recorded; leases have lengths, projects an allowed isolation."""

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
ALTER TABLE run ADD COLUMN placement jsonb;
ALTER TABLE run ADD COLUMN is_recorded boolean DEFAULT false NOT NULL;
ALTER TABLE runner ADD COLUMN lease_s integer DEFAULT 60 NOT NULL;
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
