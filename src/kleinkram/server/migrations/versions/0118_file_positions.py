"""The first position of each recording with its files, so that a map needs no previews."""

from alembic import op

revision = "0118"
down_revision = "0117"
# Programs of that schema neither write nor show positions. Triggers copy what programs of 0117 write.
compatible_from = "0106"
locked_tables = ("file", "recording_preview")
branch_labels = None
depends_on = None

# A new file holds a share lock of its blob until it is committed. The update of a preview waits for that and sees the
# file, or comes first and is seen by the file.
_STATEMENTS = """
ALTER TABLE file ADD COLUMN latitude double precision, ADD COLUMN longitude double precision;

UPDATE file SET latitude = preview.latitude, longitude = preview.longitude
    FROM recording_preview preview WHERE preview.blob_id = file.blob_id AND preview.latitude IS NOT NULL;

CREATE INDEX ix_file_position ON file (mission_id, start_ns, id) INCLUDE (latitude, longitude)
    WHERE latitude IS NOT NULL AND deleted_at IS NULL AND origin <> 'run';

CREATE FUNCTION copy_position_from_preview() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  PERFORM FROM blob WHERE blob.id = NEW.blob_id FOR SHARE;
  SELECT preview.latitude, preview.longitude INTO NEW.latitude, NEW.longitude
    FROM recording_preview preview WHERE preview.blob_id = NEW.blob_id;
  RETURN NEW;
END $$;
CREATE TRIGGER copy_position_from_preview BEFORE INSERT OR UPDATE OF blob_id ON file
  FOR EACH ROW EXECUTE FUNCTION copy_position_from_preview();

CREATE FUNCTION copy_position_to_files() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  PERFORM FROM blob WHERE blob.id = coalesce(NEW.blob_id, OLD.blob_id) FOR NO KEY UPDATE;
  UPDATE file SET latitude = NEW.latitude, longitude = NEW.longitude
    WHERE file.blob_id = coalesce(NEW.blob_id, OLD.blob_id);
  RETURN NULL;
END $$;
CREATE TRIGGER copy_new_position_to_files AFTER INSERT ON recording_preview
  FOR EACH ROW WHEN (NEW.latitude IS NOT NULL) EXECUTE FUNCTION copy_position_to_files();
CREATE TRIGGER copy_position_to_files AFTER UPDATE OF latitude, longitude ON recording_preview
  FOR EACH ROW WHEN ((OLD.latitude, OLD.longitude) IS DISTINCT FROM (NEW.latitude, NEW.longitude))
  EXECUTE FUNCTION copy_position_to_files();
CREATE TRIGGER clear_position_of_files AFTER DELETE ON recording_preview
  FOR EACH ROW WHEN (OLD.latitude IS NOT NULL) EXECUTE FUNCTION copy_position_to_files();
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
