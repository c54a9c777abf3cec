"""Mission events: moments and spans of missions that are marked by name."""

from alembic import context, op

revision = "0113"
down_revision = "0112"
# Programs of that schema neither show nor write events.
compatible_from = "0106"
# A foreign key locks the table that it refers to.
locked_tables = ("file", "mission", "person", "recording", "run", "run_finding")
branch_labels = None
depends_on = None

_STATEMENTS = """
CREATE TABLE mission_event (
    id uuid CONSTRAINT pk_mission_event PRIMARY KEY,
    mission_id uuid NOT NULL CONSTRAINT fk_mission_event_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    name text COLLATE "C" NOT NULL,
    name_key text COLLATE "C" NOT NULL,
    start_ns bigint NOT NULL,
    end_ns bigint,
    labels text[] NOT NULL DEFAULT '{}',
    colour text,
    note text NOT NULL DEFAULT '',
    refers_to text NOT NULL DEFAULT 'mission',
    file_id uuid CONSTRAINT fk_mission_event_file_id_file REFERENCES file (id) ON DELETE SET NULL,
    recording_id uuid CONSTRAINT fk_mission_event_recording_id_recording
        REFERENCES recording (id) ON DELETE SET NULL,
    topic text COLLATE "C",
    run_id uuid CONSTRAINT fk_mission_event_run_id_run REFERENCES run (id) ON DELETE SET NULL,
    finding_id bigint CONSTRAINT uq_mission_event_finding_id UNIQUE
        CONSTRAINT fk_mission_event_finding_id_run_finding REFERENCES run_finding (id) ON DELETE SET NULL,
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid NOT NULL CONSTRAINT fk_mission_event_created_by_id_person REFERENCES person (id),
    CONSTRAINT ck_mission_event_name_length CHECK (char_length(name) BETWEEN 1 AND 128),
    CONSTRAINT ck_mission_event_span CHECK (start_ns >= 0 AND end_ns >= start_ns),
    CONSTRAINT ck_mission_event_colour CHECK (colour ~ '^#[0-9a-f]{6}$'),
    CONSTRAINT ck_mission_event_note_length CHECK (char_length(note) <= 10000),
    CONSTRAINT ck_mission_event_label_count CHECK (cardinality(labels) <= 20),
    CONSTRAINT ck_mission_event_topic_length CHECK (char_length(topic) BETWEEN 1 AND 1024),
    CONSTRAINT ck_mission_event_refers_to CHECK (refers_to IN ('mission', 'file', 'recording')),
    CONSTRAINT ck_mission_event_file CHECK (refers_to = 'file' OR file_id IS NULL),
    CONSTRAINT ck_mission_event_recording CHECK (refers_to = 'recording' OR recording_id IS NULL)
) WITH (autovacuum_analyze_threshold = 0);
CREATE INDEX ix_mission_event_mission_start ON mission_event (mission_id, start_ns, id);
CREATE INDEX ix_mission_event_start_ns ON mission_event (start_ns, id);
CREATE INDEX ix_mission_event_created_at ON mission_event (created_at, id);
CREATE INDEX ix_mission_event_created_by_id ON mission_event (created_by_id);
CREATE INDEX ix_mission_event_file_id ON mission_event (file_id);
CREATE INDEX ix_mission_event_recording_id ON mission_event (recording_id);
CREATE INDEX ix_mission_event_run_id ON mission_event (run_id);
CREATE INDEX ix_mission_event_name_key ON mission_event (name_key, mission_id);
CREATE INDEX ix_mission_event_name_words ON mission_event
    USING gin (name_key gin_trgm_ops) WITH (gin_pending_list_limit = 256);
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON mission_event TO {role}")
