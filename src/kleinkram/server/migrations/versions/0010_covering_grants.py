"""What decides of a grant stands in its indexes, so that rights are found without reading the grants."""

from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

_DECIDING = ["level", "expires_at"]


def upgrade() -> None:
    for name in ("uq_access_grant_project", "uq_access_grant_mission", "ix_access_grant_group_id"):
        op.drop_index(name, table_name="access_grant")
    for noun in ("project", "mission"):
        op.create_index(
            f"uq_access_grant_{noun}",
            "access_grant",
            [f"{noun}_id", "group_id"],
            unique=True,
            postgresql_include=_DECIDING,
        )
    included = ["project_id", "mission_id", *_DECIDING]
    op.create_index("ix_access_grant_group_id", "access_grant", ["group_id"], postgresql_include=included)
