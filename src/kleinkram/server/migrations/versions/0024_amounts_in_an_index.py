"""What all missions that somebody sees amount to is added up in an index, without reading the missions.

A mission whose files changed since they were last added up has no number of files, instead of one that is too old:
what says so is not in the index. A trigger takes it away, whoever writes. With 100 000 missions the migration takes a
second, in which none is written.
"""

from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None

_FORGET = """
CREATE FUNCTION forget_file_count() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  NEW.file_count := NULL;
  RETURN NEW;
END $$
"""
_ON_MISSIONS = """
CREATE TRIGGER forget_file_count BEFORE UPDATE OF files_revision ON mission
  FOR EACH ROW WHEN (OLD.files_revision <> NEW.files_revision) EXECUTE FUNCTION forget_file_count()
"""
_OLD = "UPDATE mission SET file_count = NULL WHERE file_count IS NOT NULL AND derived_revision <> files_revision"


def upgrade() -> None:
    # All that follows needs no stronger lock, and whoever holds a mission to write it is waited for: two that have
    # begun would wait for each other.
    op.execute("LOCK TABLE mission IN EXCLUSIVE MODE")
    op.execute(_FORGET)
    op.execute(_ON_MISSIONS)
    op.execute(_OLD)
    op.create_index(
        "ix_mission_amounts",
        "mission",
        ["project_id"],
        postgresql_where="deleted_at IS NULL",
        postgresql_include=["id", "file_count", "size_bytes", "duration_ns"],
    )
