"""Recordings that runs made from others are derived."""

from alembic import op

revision = "0103"
down_revision = "0102"
branch_labels = None
depends_on = None

# The recordings of missions with derived files are derived again, by a periodic job that looks for outdated ones.
_STATEMENTS = """
ALTER TABLE recording ADD COLUMN is_derived boolean DEFAULT false NOT NULL;
ALTER TABLE recording DROP CONSTRAINT uq_recording_mission_id_name_kind;
ALTER TABLE recording ADD CONSTRAINT uq_recording_mission_id_name_kind_is_derived
    UNIQUE (mission_id, name, kind, is_derived);
UPDATE mission SET files_revision = files_revision + 1
    WHERE id IN (SELECT mission_id FROM file WHERE origin = 'run' AND deleted_at IS NULL);
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
