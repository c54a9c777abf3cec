"""What the upload protocol leaves to time: finishing after a crash, expiry, and rest at the store."""

import datetime

from procrastinate import JobContext
from sqlalchemy import Row, func, select, update

from kleinkram.contract.events import ChangeKind
from kleinkram.contract.uploads import UploadState
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.jobs.job_context import app_context
from kleinkram.server.jobs.queue import Job, queue
from kleinkram.server.tables import blob, upload
from kleinkram.server.uploads.completion import finish_stale

_STALE_S = 30
_BATCH = 500


@queue.periodic(cron="* * * * *")
@queue.task(name=Job.finish_uploads.value, pass_context=True, queueing_lock="finish_uploads", lock="finish_uploads")
async def finish_uploads(job_context: JobContext, timestamp: int = 0) -> None:
    """Finish, expire and clean up uploads."""
    await tend_uploads(app_context(job_context), stale_s=_STALE_S)


async def tend_uploads(context: AppContext, *, stale_s: float) -> None:
    """Do one round: what a crash left is finished, what nobody continued expires, what ended leaves no bytes behind."""
    await finish_stale(context, older_than_s=stale_s)
    async with context.database.begin() as db:
        lapsed = (upload.c.state == UploadState.open.value) & (upload.c.expires_at < func.now())
        expired = update(upload).where(lapsed).values(state=UploadState.expired.value)
        gone = await db.execute(expired.returning(upload.c.id, upload.c.mission_id))
        await publish(
            db, [ChangeEvent("upload", ChangeKind.removed, row.id, mission_id=row.mission_id) for row in gone]
        )
    ended = [UploadState.aborted.value, UploadState.expired.value, UploadState.done.value]
    used = select(blob.c.id).where(blob.c.store_id == upload.c.store_id, blob.c.key == upload.c.key).exists()
    statement = select(upload).where(upload.c.cleaned_at.is_(None), upload.c.state.in_(ended), ~used).limit(_BATCH)
    async with context.database.begin() as db:
        rows = (await db.execute(statement)).all()
    for row in rows:
        await _clean(context, row)


async def _clean(context: AppContext, row: Row[tuple[object, ...]]) -> None:
    # Also multipart uploads whose id was never written down: the process died between the store's answer and the row.
    for key, multipart_id in await context.storage.open_multiparts(row.key):
        await context.storage.abort_multipart(key, multipart_id)
    await context.storage.delete(row.key)
    async with context.database.begin() as db:
        # A part that was on its way when the upload ended can still arrive until its address expires.
        quiet = upload.c.lease_ends_at < func.now() - datetime.timedelta(seconds=context.settings.part_url_s)
        await db.execute(update(upload).where(upload.c.id == row.id, quiet).values(cleaned_at=func.now()))
