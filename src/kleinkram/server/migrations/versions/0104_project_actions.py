"""Actions that projects name, and the runs that these start by themselves."""

from alembic import context, op

revision = "0104"
down_revision = "0103"
branch_labels = None
depends_on = None

_STATEMENTS = """
CREATE TABLE project_action (
    id uuid CONSTRAINT pk_project_action PRIMARY KEY,
    project_id uuid NOT NULL
        CONSTRAINT fk_project_action_project_id_project REFERENCES project (id) ON DELETE CASCADE,
    action_id uuid NOT NULL CONSTRAINT fk_project_action_action_id_action REFERENCES action (id) ON DELETE CASCADE,
    trigger text NOT NULL CONSTRAINT ck_project_action_trigger CHECK (trigger IN ('complete', 'idle')),
    idle_s integer,
    parameters jsonb NOT NULL,
    added_by_id uuid NOT NULL CONSTRAINT fk_project_action_added_by_id_person REFERENCES person (id),
    created_at timestamptz DEFAULT now() NOT NULL,
    CONSTRAINT uq_project_action_project_id_action_id UNIQUE (project_id, action_id),
    CONSTRAINT ck_project_action_idle CHECK ((trigger = 'idle') = (idle_s IS NOT NULL))
);
CREATE INDEX ix_project_action_action_id ON project_action (action_id);
CREATE TABLE project_action_mission (
    project_action_id uuid NOT NULL CONSTRAINT fk_project_action_mission_project_action_id_project_action
        REFERENCES project_action (id) ON DELETE CASCADE,
    mission_id uuid NOT NULL
        CONSTRAINT fk_project_action_mission_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    files_revision bigint NOT NULL,
    problem text,
    retry_at timestamptz,
    decided_at timestamptz DEFAULT now() NOT NULL,
    CONSTRAINT pk_project_action_mission PRIMARY KEY (project_action_id, mission_id)
);
CREATE INDEX ix_project_action_mission_mission_id ON project_action_mission (mission_id);
CREATE TABLE automatic_run (
    mission_id uuid NOT NULL
        CONSTRAINT fk_automatic_run_mission_id_mission REFERENCES mission (id) ON DELETE CASCADE,
    version_id uuid NOT NULL
        CONSTRAINT fk_automatic_run_version_id_action_version REFERENCES action_version (id) ON DELETE CASCADE,
    inputs_sha256 bytea NOT NULL,
    run_id uuid CONSTRAINT fk_automatic_run_run_id_run REFERENCES run (id) ON DELETE SET NULL,
    created_at timestamptz DEFAULT now() NOT NULL,
    CONSTRAINT pk_automatic_run PRIMARY KEY (mission_id, version_id, inputs_sha256)
);
CREATE INDEX ix_automatic_run_run_id ON automatic_run (run_id);
CREATE INDEX ix_automatic_run_version_id ON automatic_run (version_id);
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
    role = context.config.attributes["serving_role"]
    tables = "project_action, project_action_mission, automatic_run"
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON {tables} TO {role}")
