"""Grants on projects and grants on missions are found in an index each.

Whoever has very many on missions and some on projects had all of them read for either, with each list.
"""

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for name, place in (("ix_access_grant_projects", "project_id"), ("ix_access_grant_missions", "mission_id")):
        op.create_index(
            name,
            "access_grant",
            ["group_id"],
            postgresql_include=[place, "level", "expires_at"],
            postgresql_where=sa.text(f"{place} IS NOT NULL"),
        )
