"""The index of the missions of a project knows their ids, so that who may see which are counted by it alone."""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None

_NAME = "uq_mission_name_key_live"


def upgrade() -> None:
    op.drop_index(_NAME, table_name="mission")
    op.create_index(
        _NAME,
        "mission",
        ["project_id", "name_key"],
        unique=True,
        postgresql_where=sa.text("deleted_at IS NULL"),
        postgresql_include=["id"],
    )
