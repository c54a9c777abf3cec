"""The index of the words of all paths goes: two hold them, by whether a file has a time."""

from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.drop_index("ix_file_words", table_name="file")
