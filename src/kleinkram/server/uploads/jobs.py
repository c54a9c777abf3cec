"""The periodic job of uploads: finishes what a crash left, expires abandoned uploads, deletes bytes of ended ones."""

import datetime
import logging

from procrastinate import JobContext
from sqlalchemy import delete, func, select, update

from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.uploads import UploadState
from kleinkram.server.access.actor import find_person
from kleinkram.server.change_events import publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.jobs.execution import app_context
from kleinkram.server.jobs.queue import Job, queue
from kleinkram.server.tables import blob, upload
from kleinkram.server.uploads import queries
from kleinkram.server.uploads.completion import finish_uploads, removed_event
from kleinkram.server.uploads.queries import UploadRow

_log = logging.getLogger("kleinkram.uploads")
_STALE_AFTER_S = 30
_BATCH = 500
_RETENTION = datetime.timedelta(days=30)
_ENDED_STATES = (UploadState.aborted.value, UploadState.expired.value, UploadState.done.value)


@queue.periodic(cron="* * * * *")
@queue.task(name=Job.finish_uploads.value, pass_context=True, queueing_lock="finish_uploads", lock="finish_uploads")
async def run_upload_maintenance(job_context: JobContext, timestamp: int = 0) -> None:
    """Finish, expire and clean up uploads."""
    await maintain_uploads(app_context(job_context), stale_after_s=_STALE_AFTER_S)


async def maintain_uploads(context: AppContext, *, stale_after_s: float) -> None:
    """Do one round: finish what a crash left, expire abandoned uploads, delete the bytes of ended ones."""
    before = func.now() - datetime.timedelta(seconds=stale_after_s)
    is_stale = (upload.c.state == UploadState.completing.value) & (upload.c.completing_since < before)
    statement = queries.select_uploads().where(is_stale).order_by(upload.c.completing_since).limit(_BATCH)
    async with context.database.begin() as db:
        stale = await queries.read_rows(db, statement)
    for row in stale:
        await _finish_stale(context, row)
    async with context.database.begin() as db:
        is_abandoned = (upload.c.state == UploadState.open.value) & (upload.c.expires_at < func.now())
        expire = update(upload).where(is_abandoned).values(state=UploadState.expired.value)
        expired = await db.execute(expire.returning(upload.c.id, upload.c.mission_id))
        await publish(db, [removed_event(row.id, row.mission_id) for row in expired])
    is_used = select(blob.c.id).where(blob.c.store_id == upload.c.store_id, blob.c.key == upload.c.key).exists()
    is_unclean = upload.c.cleaned_at.is_(None) & upload.c.state.in_(_ENDED_STATES) & ~is_used
    async with context.database.begin() as db:
        unclean = queries.select_uploads().where(is_unclean).order_by(upload.c.created_at).limit(_BATCH)
        ended = await queries.read_rows(db, unclean)
    for row in ended:
        await _clean_up(context, row)


async def _finish_stale(context: AppContext, row: UploadRow) -> None:
    """Finish an upload on behalf of the person who began it, with their current rights."""
    async with context.database.begin() as db:
        actor = await find_person(db, row.person_id)
        if actor is None:
            end = update(upload).where(upload.c.id == row.id).values(state=UploadState.aborted.value)
            await db.execute(end)
            await publish(db, [removed_event(row.id, row.mission_id)])
            return
    try:
        await finish_uploads(context, actor.for_request("complete_uploads", request_id=None, address=None), [row])
    except KleinkramError as error:  # the other uploads must not wait for it
        _log.warning("upload not finished", extra={"fields": {"upload_id": str(row.id), "reason": str(error)}})


async def _clean_up(context: AppContext, row: UploadRow) -> None:
    # Also multipart uploads whose id was never recorded: the process died between the store's answer and the row.
    for multipart in await context.storage.list_multiparts(row.key):
        await context.storage.abort_multipart(multipart.key, multipart.multipart_id)
    await context.storage.delete(row.key)
    async with context.database.begin() as db:
        # A part that was being sent when the upload ended can still arrive until its URL expires.
        urls_expired = upload.c.lease_ends_at < func.now() - datetime.timedelta(seconds=context.settings.part_url_s)
        await db.execute(update(upload).where(upload.c.id == row.id, urls_expired).values(cleaned_at=func.now()))


async def delete_cleaned_uploads(db: Connection) -> None:
    """Delete ended uploads a month after their objects."""
    await db.execute(delete(upload).where(upload.c.cleaned_at < func.now() - _RETENTION))
