"""How long it is remembered that a job failed, that an upload ended, and that somebody was about to sign in."""

from sqlalchemy import text

from kleinkram.server.db import Connection

_JOBS = text(
    "DELETE FROM procrastinate_jobs j WHERE j.status IN ('failed', 'cancelled', 'aborted') AND NOT EXISTS"
    " (SELECT 1 FROM procrastinate_events e WHERE e.job_id = j.id AND e.at > now() - interval '7 days')"
)
_UPLOADS = text("DELETE FROM upload WHERE cleaned_at < now() - interval '30 days'")

_CODES = text("DELETE FROM one_time_code WHERE expires_at < now() - interval '30 days'")
_LOGINS = text("DELETE FROM login_request WHERE expires_at < now() - interval '1 day'")
_JOURNEYS = text("DELETE FROM oidc_login WHERE expires_at < now()")


async def forget_ended(db: Connection) -> None:
    """Drop failed jobs after a week; uploads that left nothing behind, and codes, after a month; logins under way."""
    for statement in (_JOBS, _UPLOADS, _CODES, _LOGINS, _JOURNEYS):
        await db.execute(statement)
