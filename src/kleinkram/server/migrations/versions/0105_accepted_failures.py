"""Acceptances name the failures that they cover, and reports of checks the profiles that they were made by."""

from alembic import op

revision = "0105"
down_revision = "0104"
# Programs of that schema do not read the new column; what they accept covers nothing here.
compatible_from = "0104"
branch_labels = None
depends_on = None

# An acceptance from before covers what it covered when the mission was last checked. These missions are checked again.
_STATEMENTS = """
ALTER TABLE check_acceptance ADD COLUMN failures jsonb DEFAULT '[]' NOT NULL;
ALTER TABLE check_acceptance DROP CONSTRAINT ck_check_acceptance_ended;
ALTER TABLE check_acceptance ADD CONSTRAINT ck_check_acceptance_ended
    CHECK (ended IN ('withdrawn', 'replaced', 'files_changed'));
UPDATE check_acceptance SET failures = (
    SELECT coalesce(jsonb_agg(DISTINCT jsonb_build_array(
        one -> 'status', one -> 'topic', one -> 'file', one -> 'limit', one -> 'action', version.number,
        CASE WHEN one ->> 'source' = 'action' THEN one -> 'message' END)), '[]')
    FROM mission_checks
    CROSS JOIN jsonb_array_elements(checks) AS one
    LEFT JOIN run ON run.id = (one ->> 'run_id')::uuid
    LEFT JOIN action_version AS version ON version.id = run.version_id
    WHERE mission_checks.mission_id = check_acceptance.mission_id
        AND one ->> 'acceptance_id' = check_acceptance.id::text
) WHERE ended IS NULL;
ALTER TABLE check_report ADD COLUMN profiles text[] DEFAULT '{}' NOT NULL;
UPDATE mission_checks SET is_outdated = true
    WHERE mission_id IN (SELECT mission_id FROM check_acceptance WHERE ended IS NULL);
"""


def upgrade() -> None:
    op.get_bind().connection.cursor().execute(_STATEMENTS)
