"""Maintenance of runs: expired leases, runs of deleted missions, obsolete log chunks."""

from procrastinate import JobContext
from sqlalchemy import Row, delete, func, or_, select, text

from kleinkram.server.blobs.garbage_collection import is_deletion_paused
from kleinkram.server.context import AppContext
from kleinkram.server.jobs.attempts import app_context
from kleinkram.server.jobs.queue import Job, queue
from kleinkram.server.runs.lifecycle import cancel_orphans, requeue_lost_runs
from kleinkram.server.tables import log_chunk, run
from kleinkram.server.tables.runs import ACTIVE

_BATCH = 500


@queue.periodic(cron="* * * * *")
@queue.task(name=Job.maintain_runs.value, pass_context=True, queueing_lock="maintain_runs", lock="maintain_runs")
async def maintain_runs(job_context: JobContext, timestamp: int = 0) -> None:
    """Maintain runs, once a minute."""
    await maintain_runs_once(app_context(job_context))


async def maintain_runs_once(context: AppContext) -> None:
    """Do one batch; the next round continues."""
    async with context.database.begin() as db:
        await requeue_lost_runs(db)
        await cancel_orphans(db)
    for row in await _obsolete_chunks(context):
        await context.storage.delete(row.key)
        async with context.database.begin() as db:
            await db.execute(delete(log_chunk).where(log_chunk.c.key == row.key))


async def _obsolete_chunks(context: AppContext) -> list[Row[tuple[str]]]:
    """Return chunks of logs that are stored as a whole, of earlier attempts or deleted runs, or never uploaded."""
    over = run.c.state.not_in(ACTIVE)
    never_uploaded = log_chunk.c.kept_at.is_(None) & (log_chunk.c.created_at < func.now() - text("interval '1 day'"))
    obsolete = or_(
        log_chunk.c.run_id.is_(None),
        run.c.log_blob_id.is_not(None) & over,
        over & (log_chunk.c.attempt < run.c.attempt),
        never_uploaded,
    )
    stmt = select(log_chunk.c.key).outerjoin(run, run.c.id == log_chunk.c.run_id)
    due = stmt.where(log_chunk.c.store_id == context.settings.store_id, obsolete).limit(_BATCH)
    async with context.database.begin() as db:
        return [] if await is_deletion_paused(db) else list((await db.execute(due)).all())
