"""The first position of each recording beside its preview, for maps."""

from alembic import op

revision = "0117"
down_revision = "0116"
# Programs of that schema neither write nor show positions.
compatible_from = "0106"
locked_tables = ("recording_preview",)
branch_labels = None
depends_on = None

# Previews that an earlier program made, also during the upgrade, were not searched for a position.
_STATEMENT = """
ALTER TABLE recording_preview
    ADD COLUMN is_position_known boolean NOT NULL DEFAULT false,
    ADD COLUMN latitude double precision,
    ADD COLUMN longitude double precision,
    ADD CONSTRAINT ck_recording_preview_position CHECK (
        (latitude IS NULL) = (longitude IS NULL)
        AND latitude BETWEEN -90 AND 90 AND longitude BETWEEN -180 AND 180
    )
"""


def upgrade() -> None:
    op.execute(_STATEMENT)
