"""When its recording begins is kept with each file, so that lists by time are walked in one index.

Those by path begin with the first project, without all missions being sorted.

Triggers keep it, whoever writes: a file that comes takes it from its blob, a blob that is read gives it to its files.
With 2 million files the migration takes minutes.
"""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None

_FILL = "UPDATE file SET start_ns = blob.start_ns FROM blob WHERE blob.id = blob_id AND blob.start_ns IS NOT NULL"
# The lock lets a reading of the same bytes end first, or wait until this file can be seen by it.
_TAKE = """
CREATE FUNCTION take_start() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  SELECT blob.start_ns INTO NEW.start_ns FROM blob WHERE blob.id = NEW.blob_id FOR SHARE;
  RETURN NEW;
END $$
"""
_ON_FILES = """
CREATE TRIGGER take_start BEFORE INSERT OR UPDATE OF blob_id ON file
  FOR EACH ROW EXECUTE FUNCTION take_start()
"""
_GIVE = """
CREATE FUNCTION give_start() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  UPDATE file SET start_ns = NEW.start_ns WHERE file.blob_id = NEW.id;
  RETURN NULL;
END $$
"""
_ON_BLOBS = """
CREATE TRIGGER give_start AFTER UPDATE OF start_ns ON blob
  FOR EACH ROW WHEN (OLD.start_ns IS DISTINCT FROM NEW.start_ns) EXECUTE FUNCTION give_start()
"""


def upgrade() -> None:
    op.add_column("file", sa.Column("start_ns", sa.BigInteger(), nullable=True))
    op.execute(_FILL)
    for statement in (_TAKE, _ON_FILES, _GIVE, _ON_BLOBS):
        op.execute(statement)
    op.create_index(
        "ix_file_begun",
        "file",
        [sa.text("coalesce(start_ns, '-9223372036854775808'::bigint)"), "id"],
        unique=False,
        postgresql_where=sa.text("deleted_at IS NULL"),
        postgresql_include=["start_ns", "blob_id", "mission_id"],
    )
    op.drop_index("ix_blob_begun", table_name="blob")
    op.create_index("ix_project_name", "project", ["name"], unique=False)
