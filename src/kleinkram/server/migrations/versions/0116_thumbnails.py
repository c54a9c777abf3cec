"""A thumbnail beside the preview of each recording, for lists."""

from alembic import op

revision = "0116"
down_revision = "0115"
# Programs of that schema neither write nor show thumbnails.
compatible_from = "0106"
locked_tables = ("recording_preview",)
branch_labels = None
depends_on = None

_STATEMENT = """
ALTER TABLE recording_preview
    ADD COLUMN thumbnail bytea
        CONSTRAINT ck_recording_preview_thumbnail CHECK (octet_length(thumbnail) <= 32768)
"""


def upgrade() -> None:
    op.execute(_STATEMENT)
