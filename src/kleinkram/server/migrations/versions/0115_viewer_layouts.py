"""Layouts of the mission viewer."""

from alembic import context, op

revision = "0115"
down_revision = "0114"
# Programs of that schema neither show nor write layouts.
compatible_from = "0106"
# A foreign key locks the table that it refers to.
locked_tables = ("person", "project")
branch_labels = None
depends_on = None

_STATEMENTS = """
CREATE TABLE viewer_layout (
    id uuid CONSTRAINT pk_viewer_layout PRIMARY KEY,
    project_id uuid NOT NULL CONSTRAINT fk_viewer_layout_project_id_project REFERENCES project (id) ON DELETE CASCADE,
    name text COLLATE "C" NOT NULL,
    name_key text COLLATE "C" NOT NULL,
    panels text[] NOT NULL,
    is_shared boolean NOT NULL,
    is_default boolean NOT NULL DEFAULT false,
    created_at timestamptz NOT NULL DEFAULT now(),
    created_by_id uuid NOT NULL CONSTRAINT fk_viewer_layout_created_by_id_person REFERENCES person (id),
    CONSTRAINT ck_viewer_layout_name_length CHECK (char_length(name) BETWEEN 1 AND 128),
    CONSTRAINT ck_viewer_layout_panel_count CHECK (cardinality(panels) BETWEEN 1 AND 16),
    CONSTRAINT ck_viewer_layout_default_is_shared CHECK (is_shared OR NOT is_default)
);
CREATE UNIQUE INDEX uq_viewer_layout_shared_name ON viewer_layout (project_id, name_key) WHERE is_shared;
CREATE UNIQUE INDEX uq_viewer_layout_personal_name ON viewer_layout (created_by_id, project_id, name_key)
    WHERE NOT is_shared;
CREATE UNIQUE INDEX uq_viewer_layout_default ON viewer_layout (project_id) WHERE is_default;
CREATE INDEX ix_viewer_layout_project_id ON viewer_layout (project_id, name_key, id);
CREATE INDEX ix_viewer_layout_created_by_id ON viewer_layout (created_by_id);
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON viewer_layout TO {role}")
