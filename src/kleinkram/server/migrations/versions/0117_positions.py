"""The first position of each recording beside its preview, for maps."""

from alembic import op

revision = "0117"
down_revision = "0116"
# Programs of that schema neither write nor show positions.
compatible_from = "0106"
locked_tables = ("recording_preview",)
branch_labels = None
depends_on = None

_STATEMENTS = (
    """
    ALTER TABLE recording_preview
        ADD COLUMN latitude double precision,
        ADD COLUMN longitude double precision,
        ADD CONSTRAINT ck_recording_preview_position CHECK (
            (latitude IS NULL) = (longitude IS NULL)
            AND latitude BETWEEN -90 AND 90 AND longitude BETWEEN -180 AND 180
        )
    """,
    # Of recordings that have positions, earlier previews are made again in time; until then, they stay as they are.
    """
    UPDATE recording_preview SET version = 0 WHERE state = 'ready' AND EXISTS (
        SELECT FROM topic WHERE topic.blob_id = recording_preview.blob_id
            AND message_type ~ '(NavSatFix|GPSFix|LocationFix|GeoPoint(Stamped)?)$'
    )
    """,
)


def upgrade() -> None:
    for statement in _STATEMENTS:
        op.execute(statement)
