"""Checks and verdicts of runs; topics and labels of metrics."""

from alembic import context, op

revision = "0101"
down_revision = "0100"
branch_labels = None
depends_on = None

# Runs that ended before have a verdict by their findings.
_STATEMENTS = """
ALTER TABLE run ADD COLUMN verdict text;
ALTER TABLE run ADD COLUMN check_counts jsonb DEFAULT '{}' NOT NULL;
ALTER TABLE run ADD CONSTRAINT ck_run_verdict
    CHECK (verdict IN ('good', 'warnings', 'bad', 'outdated', 'running', 'unchecked'));
UPDATE run SET verdict = CASE WHEN finding_counts ? 'error' THEN 'bad' ELSE 'warnings' END
    WHERE state = 'done' AND finding_counts ?| ARRAY['error', 'warning'];
ALTER TABLE run_metric ADD COLUMN topic text;
ALTER TABLE run_metric ADD COLUMN labels jsonb DEFAULT '{}' NOT NULL;
CREATE TABLE run_check (
    id bigint GENERATED ALWAYS AS IDENTITY CONSTRAINT pk_run_check PRIMARY KEY,
    run_id uuid NOT NULL CONSTRAINT fk_run_check_run_id_run REFERENCES run (id) ON DELETE CASCADE,
    name text COLLATE "C" NOT NULL,
    status text NOT NULL CONSTRAINT ck_run_check_status
        CHECK (status IN ('ok', 'warning', 'error', 'not_made', 'needs_content')),
    message text NOT NULL,
    value double precision,
    "limit" double precision,
    unit text,
    topic text,
    file text,
    time_ns bigint
);
CREATE INDEX ix_run_check_run_id ON run_check (run_id, id);
CREATE INDEX ix_run_check_name ON run_check (name, id);
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON run_check TO {role}")
