"""Periodic jobs that concern several features: maintenance of runs, garbage collection, expiry of the audit log."""

from procrastinate import JobContext
from sqlalchemy import delete, func, or_, select, text

from kleinkram.server.audit.retention import expire_events
from kleinkram.server.auth.one_time_codes import delete_expired_codes
from kleinkram.server.blobs import garbage_collection, recording_previews, scrub, service
from kleinkram.server.checks.jobs import judge_forgotten
from kleinkram.server.context import AppContext
from kleinkram.server.http.rate_limit import delete_expired_counts
from kleinkram.server.jobs.execution import app_context
from kleinkram.server.jobs.queue import Job, delete_failed_jobs, queue, requeue_unknown_jobs
from kleinkram.server.recordings.derive import derive_forgotten
from kleinkram.server.runs.automatic import enqueue_automatic_runs
from kleinkram.server.runs.lifecycle import cancel_orphans, requeue_lost_runs
from kleinkram.server.tables import log_chunk, run, run_log
from kleinkram.server.tables.runs import ACTIVE
from kleinkram.server.trash.service import empty_trash
from kleinkram.server.uploads.jobs import delete_cleaned_uploads

_BATCH = 1000
_LOG_CHUNKS = 500
_MAX_REVERIFIED = 500
_MAX_PREVIEWS = 200


@queue.periodic(cron="* * * * *")
@queue.task(name=Job.maintain_runs.value, pass_context=True, queueing_lock="maintain_runs", lock="maintain_runs")
async def run_maintenance_of_runs(job_context: JobContext, timestamp: int = 0) -> None:
    """Do one round of `maintain_runs`."""
    await maintain_runs(app_context(job_context))


async def maintain_runs(context: AppContext) -> None:
    """Requeue lost runs, cancel runs of deleted missions, start due ones, and delete a batch of obsolete log chunks."""
    async with context.database.begin() as db:
        await requeue_lost_runs(db)
        await cancel_orphans(db)
    async with context.database.begin() as db:
        await enqueue_automatic_runs(db)
    # Of logs that are stored as a whole, of earlier attempts or deleted runs, or never uploaded.
    has_ended = run.c.state.not_in(ACTIVE)
    never_uploaded = log_chunk.c.confirmed_at.is_(None) & (
        log_chunk.c.created_at < func.now() - text("interval '1 day'")
    )
    obsolete = or_(
        log_chunk.c.run_id.is_(None),
        or_(run.c.log_blob_id.is_not(None), run_log.c.run_id.is_not(None)) & has_ended,
        has_ended & (log_chunk.c.attempt < run.c.attempt),
        never_uploaded,
    )
    stmt = select(log_chunk.c.key).outerjoin(run, run.c.id == log_chunk.c.run_id)
    stmt = stmt.outerjoin(run_log, run_log.c.run_id == run.c.id)
    due = stmt.where(log_chunk.c.store_id == context.settings.store_id, obsolete).limit(_LOG_CHUNKS)
    async with context.database.begin() as db:
        if await garbage_collection.is_deletion_paused(db):
            return
        keys = (await db.execute(due)).scalars().all()
    for key in keys:
        await context.storage.delete(key)
        async with context.database.begin() as db:
            await db.execute(delete(log_chunk).where(log_chunk.c.key == key))


@queue.periodic(cron="*/10 * * * *")
@queue.task(name=Job.collect_garbage.value, pass_context=True, queueing_lock="collect_garbage", lock="collect_garbage")
async def run_garbage_collection(job_context: JobContext, timestamp: int = 0) -> None:
    """Do one round of `collect_garbage`."""
    await collect_garbage(app_context(job_context))


async def collect_garbage(context: AppContext) -> None:
    """Re-queue unfinished blobs, empty the trash, delete unreferenced objects; each at most a batch a round."""
    store_id, settings = context.settings.store_id, context.settings
    async with context.database.begin() as db:
        await service.requeue_unfinished(db, store_id=store_id, limit=_BATCH)
        await derive_forgotten(db, limit=_BATCH)
        await judge_forgotten(db, limit=_BATCH)
    async with context.database.begin() as db:
        days = settings.reverify_days
        await service.verify_old(db, store_id=store_id, older_than_days=days, limit=_MAX_REVERIFIED)
        await scrub.begin_due_scrub(db, settings)
        if settings.recording_previews:
            await recording_previews.enqueue_missing(db, store_id=store_id, limit=_MAX_PREVIEWS)
    async with context.database.begin() as db:
        await requeue_unknown_jobs(db)
        await delete_failed_jobs(db)
        await delete_cleaned_uploads(db)
        await delete_expired_codes(db)
        await delete_expired_counts(db)
        await empty_trash(db, older_than_days=settings.trash_days, limit=_BATCH)
    async with context.database.begin() as db:
        await garbage_collection.mark_unreferenced(db, limit=_BATCH)
    async with context.database.begin() as db:
        # Checked after marking, so that no object is deleted that a backup saw unmarked.
        if await garbage_collection.is_deletion_paused(db):
            return
        objects = await garbage_collection.objects_to_delete(
            db, store_id=store_id, grace_s=settings.garbage_grace_s, limit=_BATCH
        )
        preview_keys = await recording_previews.keys_to_delete(db, store_id=store_id, limit=_BATCH)
    for key in preview_keys:
        await context.storage.delete(key)
        async with context.database.begin() as db:
            await recording_previews.record_deleted_object(db, key)
    for row in objects:
        await _delete_object(context, row)


async def _delete_object(context: AppContext, row: garbage_collection.ObjectToDelete) -> None:
    if row.preview_key is not None:
        await context.storage.delete(row.preview_key)
    await context.storage.delete(row.key)
    async with context.database.begin() as db:
        await garbage_collection.delete_row(db, row.id)


@queue.periodic(cron="17 3 * * *")
@queue.task(
    name=Job.expire_audit_log.value, pass_context=True, queueing_lock="expire_audit_log", lock="expire_audit_log"
)
async def run_expiry_of_audit_log(job_context: JobContext, timestamp: int = 0) -> None:
    """Delete the events of the audit log that are older than the settings allow."""
    await expire_events(app_context(job_context))
