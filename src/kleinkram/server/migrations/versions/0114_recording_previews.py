"""Previews of recordings."""

from alembic import context, op

revision = "0114"
down_revision = "0113"
# Programs of that schema make and delete no previews.
compatible_from = "0106"
locked_tables = ("blob",)
branch_labels = None
depends_on = None

_STATEMENTS = """
CREATE TABLE recording_preview (
    blob_id uuid CONSTRAINT pk_recording_preview PRIMARY KEY
        CONSTRAINT fk_recording_preview_blob_id_blob REFERENCES blob (id) ON DELETE CASCADE,
    store_id text DEFAULT 'main' NOT NULL,
    key text,
    state text NOT NULL
        CONSTRAINT ck_recording_preview_state CHECK (state IN ('making', 'ready', 'failed', 'deleted')),
    version integer NOT NULL,
    size_bytes bigint,
    reason text,
    temporary_failures integer DEFAULT 0 NOT NULL,
    made_at timestamptz DEFAULT now() NOT NULL,
    CONSTRAINT uq_recording_preview_store_id_key UNIQUE (store_id, key),
    CONSTRAINT ck_recording_preview_ready CHECK (state <> 'ready' OR (key IS NOT NULL AND size_bytes IS NOT NULL))
);
CREATE INDEX ix_recording_preview_deleted ON recording_preview (blob_id)
    WHERE state IN ('deleted', 'failed') AND key IS NOT NULL;
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
    role = context.config.attributes["serving_role"]
    op.execute(f"GRANT SELECT, INSERT, UPDATE, DELETE ON recording_preview TO {role}")
