"""Ten years of a lab: what missions amount to is kept, and words are found by their trigrams.

Indexes are built in the one transaction of the migration, not concurrently: it is all there or not at all, and nobody
serves meanwhile. With 2 million files and 20 million topics it takes about three minutes.
"""

import sqlalchemy as sa
from alembic import context, op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None

# Of what was derived already; of other missions it is kept when they are.
_ADD_UP = """
UPDATE mission SET file_count = coalesce(files.file_count, 0), size_bytes = coalesce(files.size_bytes, 0),
    message_count = coalesce(files.message_count, 0), unread_count = coalesce(files.unread_count, 0),
    duration_ns = coalesce(recordings.duration_ns, 0)
  FROM mission each
  LEFT JOIN (
    SELECT mission_id, count(*) AS file_count, sum(size_bytes) AS size_bytes, sum(message_count) AS message_count,
      count(*) FILTER (WHERE summarised_at IS NULL OR content = 'pending') AS unread_count
    FROM file JOIN blob ON blob.id = blob_id WHERE file.deleted_at IS NULL GROUP BY mission_id
  ) files ON files.mission_id = each.id
  LEFT JOIN (
    SELECT mission_id, sum(end_ns - start_ns) AS duration_ns FROM recording GROUP BY mission_id
  ) recordings ON recordings.mission_id = each.id
  WHERE mission.id = each.id
"""
# Each name once: with many topics of few names it is quicker to step from name to name than to read all.
_NAMES = """
INSERT INTO topic_name (name)
  WITH RECURSIVE step AS (
    (SELECT name FROM topic ORDER BY name LIMIT 1)
    UNION ALL
    SELECT (SELECT topic.name FROM topic WHERE topic.name > step.name ORDER BY topic.name LIMIT 1)
    FROM step WHERE step.name IS NOT NULL
  )
  SELECT name FROM step WHERE name IS NOT NULL
"""
# What `array_to_string` does; that it does so for ever is said here, since an index asks for it.
_JOINED = """
CREATE FUNCTION joined(labels text[]) RETURNS text LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
  RETURN array_to_string(labels, E'\\n')
"""
# Whoever adds topics, the names are there: in their order, so that two who add the same do not wait for each other.
_KEEP_NAMES = """
CREATE FUNCTION keep_topic_names() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
  INSERT INTO topic_name (name)
    SELECT DISTINCT added.name FROM added
    WHERE NOT EXISTS (SELECT FROM topic_name WHERE topic_name.name = added.name)
    ORDER BY 1
  ON CONFLICT DO NOTHING;
  RETURN NULL;
END $$
"""
_ON_TOPICS = """
CREATE TRIGGER keep_topic_names AFTER INSERT ON topic REFERENCING NEW TABLE AS added
  FOR EACH STATEMENT EXECUTE FUNCTION keep_topic_names()
"""


def upgrade() -> None:
    op.execute("CREATE EXTENSION IF NOT EXISTS pg_trgm")
    op.execute(_JOINED)
    for name, kind in (
        ("file_count", sa.Integer()),
        ("size_bytes", sa.Numeric()),
        ("message_count", sa.Numeric()),
        ("unread_count", sa.Integer()),
        ("duration_ns", sa.Numeric()),
    ):
        op.add_column("mission", sa.Column(name, kind, nullable=True))
    op.execute(_ADD_UP)
    op.create_table(
        "topic_name",
        sa.Column("name", sa.Text(collation="C"), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_topic_name")),
    )
    op.execute(_NAMES)
    op.execute(_KEEP_NAMES)
    op.execute(_ON_TOPICS)
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON topic_name TO {role}")
    op.create_index("ix_mission_name", "mission", ["name", "id"], unique=False)
    begun = sa.text("coalesce(start_ns, '-9223372036854775808'::bigint)")
    op.create_index("ix_mission_begun", "mission", [begun, "id"], unique=False)
    for index, table, expression in (
        ("ix_topic_name_words", "topic_name", "name"),
        ("ix_file_words", "file", "path_key"),
        ("ix_file_label_words", "file", "joined(labels)"),
        ("ix_mission_name_words", "mission", "name_key"),
        ("ix_mission_note_words", "mission", "notes"),
        ("ix_mission_metadata_words", "mission", "(metadata::text)"),
    ):
        op.execute(f"CREATE INDEX {index} ON {table} USING gin ({expression} gin_trgm_ops)")
    # How long the longest lasts bounds where one begins that was under way at some time. Hostile files last for ever.
    op.create_index("ix_blob_duration", "blob", [sa.text("(end_ns::numeric - start_ns::numeric)")], unique=False)
