"""Small logs of ended runs are in the database."""

from alembic import context, op

revision = "0111"
down_revision = "0110"
# Programs of that schema do not show these logs.
compatible_from = "0106"
locked_tables = ("run",)
branch_labels = None
depends_on = None

_STATEMENTS = """
CREATE TABLE run_log (
    run_id uuid CONSTRAINT pk_run_log PRIMARY KEY
        CONSTRAINT fk_run_log_run_id_run REFERENCES run (id) ON DELETE CASCADE,
    content bytea NOT NULL
);
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON run_log TO {role}")
