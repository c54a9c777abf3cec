"""People can be erased, the audit log can expire, and sessions depend on the provider account that started them."""

from pathlib import Path

from alembic import context, op

revision = "0107"
down_revision = "0106"
# Programs of that schema do not read the new columns: their sessions do not depend on provider accounts.
compatible_from = "0106"
branch_labels = None
depends_on = None

_FUNCTIONS = "redact_audit_log(uuid), delete_expired_audit_events(bigint, integer)"


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(Path(__file__).with_suffix(".sql").read_text())
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE ON erasure TO {role}")
    op.execute(f"GRANT SELECT, INSERT, DELETE ON used_logout_token TO {role}")
    # Only migrations decide how long the audit log is kept.
    op.execute(f"GRANT SELECT ON audit_retention TO {role}")
    op.execute(f"GRANT EXECUTE ON FUNCTION {_FUNCTIONS} TO {role}")
