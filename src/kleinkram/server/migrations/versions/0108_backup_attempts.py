"""Attempts at backups, for the age of the last one."""

from alembic import context, op

revision = "0108"
down_revision = "0107"
# Programs of that schema do not read the new table.
compatible_from = "0106"
branch_labels = None
depends_on = None

_STATEMENTS = """
CREATE TABLE backup_attempt (
    id uuid CONSTRAINT pk_backup_attempt PRIMARY KEY,
    started_at timestamptz NOT NULL,
    ended_at timestamptz DEFAULT now() NOT NULL,
    snapshot_id text,
    damaged_objects bigint DEFAULT 0 NOT NULL
);
CREATE INDEX ix_backup_attempt_ended_at ON backup_attempt (ended_at);
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON backup_attempt TO {role}")
