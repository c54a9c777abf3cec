"""How long it is remembered that a job failed and that an upload ended."""

from sqlalchemy import text

from kleinkram.server.db import Connection

_JOBS = text(
    "DELETE FROM procrastinate_jobs j WHERE j.status IN ('failed', 'cancelled', 'aborted') AND NOT EXISTS"
    " (SELECT 1 FROM procrastinate_events e WHERE e.job_id = j.id AND e.at > now() - interval '7 days')"
)
_UPLOADS = text("DELETE FROM upload WHERE cleaned_at < now() - interval '30 days'")


async def forget_ended(db: Connection) -> None:
    """Drop failed jobs after a week, and uploads that left nothing behind after a month."""
    await db.execute(_JOBS)
    await db.execute(_UPLOADS)
