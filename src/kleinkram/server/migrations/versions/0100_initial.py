"""Initial schema: our tables, the job queue's tables, and the serving role's privileges."""

from pathlib import Path

from alembic import context, op
from procrastinate.schema import SchemaManager

revision = "0100"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    cursor = op.get_bind().connection.cursor()
    # The pinned minor version's schema; a newer procrastinate comes with a migration of its own.
    cursor.execute(SchemaManager.get_schema())
    cursor.execute(Path(__file__).with_suffix(".sql").read_text())
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT USAGE ON SCHEMA public TO {role}")
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON ALL TABLES IN SCHEMA public TO {role}")
    op.execute(f"GRANT USAGE, SELECT ON ALL SEQUENCES IN SCHEMA public TO {role}")
    op.execute(f"GRANT EXECUTE ON ALL FUNCTIONS IN SCHEMA public TO {role}")
    # The audit log is append-only, and only migrations change the schema's version.
    op.execute(f"REVOKE UPDATE, DELETE ON audit_event FROM {role}")
    op.execute(f"REVOKE INSERT, UPDATE, DELETE ON alembic_version FROM {role}")
