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
ALTER TABLE run ADD COLUMN launch_project_id uuid DEFAULT '00000000-0000-0000-0000-000000000000' NOT NULL;
UPDATE run SET launch_project_id = mission.project_id FROM mission
    WHERE mission.id = run.mission_id AND run.state IN ('queued', 'preparing', 'running', 'collecting');
DROP INDEX ix_run_queue;
CREATE INDEX ix_run_queue ON run (priority, launch_project_id, started_by_id, created_at, id) WHERE state = 'queued';
CREATE INDEX ix_run_launch_project_id ON run (launch_project_id, claimed_at);
DROP INDEX ix_run_started_by_id;
CREATE INDEX ix_run_started_by_id ON run (started_by_id, claimed_at);
DROP INDEX ix_run_lease_ends_at;
DROP INDEX ix_run_runner_id;
CREATE INDEX ix_run_assigned ON run (runner_id) WHERE state IN ('preparing', 'running', 'collecting');
ALTER TABLE runner ADD COLUMN lease_s integer DEFAULT 60 NOT NULL;
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
