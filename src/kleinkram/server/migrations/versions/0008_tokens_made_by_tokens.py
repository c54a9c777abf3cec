"""With which token another was made, so that it ends with that one."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("token", sa.Column("made_by_token_id", sa.Uuid(), nullable=True))
    op.create_index(op.f("ix_token_made_by_token_id"), "token", ["made_by_token_id"], unique=False)
    op.create_foreign_key(op.f("fk_token_made_by_token_id_token"), "token", "token", ["made_by_token_id"], ["id"])
    # The record knows it of those that are there.
    op.execute(
        "UPDATE token SET made_by_token_id = made.token_id FROM audit_event AS made"
        " WHERE made.operation = 'token.create' AND made.noun_id = token.id AND made.token_id IS NOT NULL"
    )
