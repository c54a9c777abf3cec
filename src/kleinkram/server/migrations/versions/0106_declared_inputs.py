"""Runs store the metadata and checks that their actions declare, and reports of checks the run that made them."""

from alembic import op

revision = "0106"
down_revision = "0105"
# Programs of that schema do not read the new columns, and launch no actions that declare such inputs.
compatible_from = "0105"
branch_labels = None
depends_on = None

# What was decided of missions was decided by the present `checks.yaml`, which no action read.
_STATEMENTS = """
ALTER TABLE run ADD COLUMN input_metadata jsonb, ADD COLUMN checks_sha256 bytea;
ALTER TABLE check_report ADD COLUMN run_id uuid
    CONSTRAINT fk_check_report_run_id_run REFERENCES run (id) ON DELETE SET NULL;
CREATE INDEX ix_check_report_run_id ON check_report (run_id);
ALTER TABLE project_action_mission ADD COLUMN checks_number integer;
UPDATE project_action_mission SET checks_number = project.checks_number
    FROM mission JOIN project ON project.id = mission.project_id WHERE mission.id = mission_id;
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
