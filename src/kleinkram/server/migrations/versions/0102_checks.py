"""Checks: versions of each project's `checks.yaml`, results and verdicts of missions, reports, acceptances, notes."""

from pathlib import Path

from alembic import context, op

revision = "0102"
down_revision = "0101"
# Programs of that schema do not know the new tables, and need not.
compatible_from = "0101"
branch_labels = None
depends_on = None

_TABLES = "project_checks, mission_checks, check_report, check_acceptance, check_note"


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(Path(__file__).with_suffix(".sql").read_text())
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON {_TABLES} TO {role}")
