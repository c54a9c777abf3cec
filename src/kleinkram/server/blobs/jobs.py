"""Jobs on blobs: read the summary by ranges, verify the bytes, sweep what is no longer wanted.

A small blob is read once, whole, for both; many are read one after the other and kept together, since of ten thousand
small files each would cost a hundred times what reading it does.
"""

import logging
import time
import uuid
from collections.abc import Mapping

from procrastinate import JobContext
from sqlalchemy import Row
from sqlalchemy.exc import DataError, IntegrityError

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.files import BlobState, ContentState, ReadDepth
from kleinkram.contract.names import file_name
from kleinkram.recordings import (
    Content,
    FailureKind,
    RecordingSummary,
    StreamRequest,
    SummaryFailed,
    UrlRequest,
    request_bytes,
    stream_request_bytes,
)
from kleinkram.server.blobs import scrubs, service
from kleinkram.server.blobs.holding import is_held_back
from kleinkram.server.blobs.reading import Readers
from kleinkram.server.blobs.scrubbing import scrub_store
from kleinkram.server.blobs.verification import Found, Unreadable, read_through
from kleinkram.server.context import AppContext
from kleinkram.server.http.rate_limit import delete_expired_counts
from kleinkram.server.jobs.courtesy import SUMMARY_PATIENCE_S, VERIFY_PATIENCE_S
from kleinkram.server.jobs.job_context import ATTEMPTS, PATIENTLY, app_context, courtesy_of, given
from kleinkram.server.jobs.queue import Job, Urgency, hasten, queue
from kleinkram.server.jobs.retention import forget_ended
from kleinkram.server.recordings.service import regroup_forgotten
from kleinkram.server.trash.emptying import empty_trash

_log = logging.getLogger("kleinkram.blobs")
_SWEEP_BATCH = 1000
# The most blobs that are queued for another verification at a time.
_MAX_REVERIFIED = 500
# A recording without an index must be read whole: at once up to this size, else when the verification reads it.
_SUMMARY_MOST_BYTES = 64 * 1024 * 1024
# Slower than any machine that we know reads the slowest format.
_SCAN_BYTES_PER_S = 5_000_000
# The extension of rosbag2's databases, beside which a killed recorder leaves a log.
_DATABASE = ".db3"
# So many small blobs are looked for, and for so long they are read, before what was found is kept; while uploads come
# in, a few.
_TAKEN_ALONG, _AT_ONCE_S, _TURN_S = 100, 2.0, 0.02
# What reading a blob through found, and what whoever read along says that it holds.
_Read = tuple[Found, RecordingSummary | SummaryFailed | None]


@queue.task(name=Job.summarise_blob.value, retry=PATIENTLY, pass_context=True)
async def summarise_blob(job_context: JobContext, ref: str) -> None:
    """Read what is in a recording, in a child process without credentials, and keep it."""
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    row = await _blob_here(context, blob_id)
    if row is None or row.path is None:
        return
    logs = await _logs_beside(context, row)
    if row.depth == ReadDepth.scan and not logs:
        return
    await courtesy_of(job_context).give_way(SUMMARY_PATIENCE_S, since=row.created_at)
    try:
        summary = await _summary(context, given(job_context, "readers", Readers), row, logs)
    except SummaryFailed as failure:
        if failure.kind is FailureKind.source and job_context.job.attempts < ATTEMPTS - 1:
            raise  # the store, not the file: worth another try
        async with context.database.begin() as db:
            await service.keep_failure(db, blob_id, str(failure))
        return
    await _keep_summary(context, blob_id, summary)
    if summary.content is Content.pending:  # only the verification reads it: somebody may wait for that
        async with context.database.begin() as db:
            await hasten(db, Job.verify_blob, blob_id)


async def _blob_here(context: AppContext, blob_id: uuid.UUID) -> Row[tuple[object, ...]] | None:
    """Return a blob that is still wanted, and whose bytes are in this server's own store."""
    async with context.database.begin() as db:
        row = await service.get_blob(db, blob_id)
    return row if row is not None and row.store_id == context.settings.store_id else None


async def _keep_summary(context: AppContext, blob_id: uuid.UUID, summary: RecordingSummary) -> None:
    try:
        async with context.database.begin() as db:
            await service.keep_summary(db, blob_id, summary)
    except (DataError, IntegrityError) as error:  # a file may say what no column holds
        _log.error("summary not kept", extra={"fields": {"blob_id": str(blob_id), "reason": str(error.orig)}})
        async with context.database.begin() as db:
            await service.keep_failure(db, blob_id, "what it says of itself does not fit into the database")


async def _logs_beside(context: AppContext, row: Row[tuple[object, ...]]) -> Mapping[str, Row[tuple[object, ...]]]:
    if row.path is None or not row.path.endswith(_DATABASE):
        return {}
    async with context.database.begin() as db:
        return await service.logs_beside(db, row.id)


async def _summary(
    context: AppContext,
    readers: Readers,
    row: Row[tuple[object, ...]],
    logs: Mapping[str, Row[tuple[object, ...]]],
) -> RecordingSummary:
    size_bytes = row.size_bytes + sum(log.size_bytes for log in logs.values())
    timeout_s = context.settings.summary_timeout_s + (size_bytes // _SCAN_BYTES_PER_S if logs else 0)

    def sign(key: str) -> str:
        return context.storage.sign_internal_get(key, expires_s=timeout_s + 60)

    wanted = {suffix: (sign(log.key), log.size_bytes) for suffix, log in logs.items()}
    request = request_bytes(
        UrlRequest(sign(row.key), row.size_bytes, file_name(row.path), wanted),
        most_bytes=_SUMMARY_MOST_BYTES,
        memory_bytes=context.settings.summary_memory_bytes,
        timeout_s=round(timeout_s),
    )
    return await readers.summary(request, owner=row.uploaded_by_id, timeout_s=timeout_s)


@queue.task(name=Job.verify_blob.value, retry=PATIENTLY, pass_context=True)
async def verify_blob(job_context: JobContext, ref: str) -> None:
    """Read a blob once, at a limited rate, and compare it with what was stated of it when it came.

    A child process without credentials reads along, and says what the whole of a recording holds.
    """
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    row = await _blob_here(context, blob_id)
    if row is None:
        return
    # What is only verified again gives way from now on, whenever it came.
    anew = job_context.job.priority < Urgency.whenever
    await courtesy_of(job_context).give_way(VERIFY_PATIENCE_S, since=None if anew else row.created_at)
    read = await _read_or_damaged(job_context, context, row)
    if read is None:
        return
    found, scan = read
    # Stored last: until then a recording that only this job reads counts as pending.
    await _keep_scan(context, blob_id, scan)
    async with context.database.begin() as db:
        await service.record_verified(db, {blob_id: found.md5})


@queue.task(name=Job.examine_blob.value, retry=PATIENTLY, pass_context=True)
async def examine_blob(job_context: JobContext, ref: str) -> None:
    """Read a small blob for all that is to be known of it, and with it others of the same person that wait."""
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    row = await _blob_here(context, blob_id)
    if row is None:
        return
    is_turn = await courtesy_of(job_context).give_way(SUMMARY_PATIENCE_S, since=row.created_at)
    until = time.monotonic() + (_TURN_S if is_turn else _AT_ONCE_S)
    read = await _read_or_damaged(job_context, context, row)
    if read is None:
        async with context.database.begin() as db:
            await service.keep_failure(db, blob_id, "its bytes are damaged or gone")
        return
    done = {blob_id: read}
    async with context.database.begin() as db:
        others = await service.taken_along(db, row, most=_TAKEN_ALONG)
    for other in others:
        if time.monotonic() > until:
            break
        try:
            read = await _read(context, given(job_context, "readers", Readers), other)
        except (FileNotFoundError, Unreadable):
            continue  # its own job will say so, as of those that were altered
        except StoreUnavailable:
            break
        if read[0].differs_from(other) is None:
            done[other.id] = read
    await _keep_examined(context, done)


async def _keep_examined(context: AppContext, done: Mapping[uuid.UUID, _Read]) -> None:
    summaries = {blob_id: scan for blob_id, (_, scan) in done.items() if isinstance(scan, RecordingSummary)}
    md5s = {blob_id: found.md5 for blob_id, (found, scan) in done.items() if not isinstance(scan, SummaryFailed)}
    try:
        async with context.database.begin() as db:
            await service.keep_examined(db, summaries, md5s)
    except (DataError, IntegrityError):  # one of them says what no column holds
        summaries, md5s = {}, {}
    for blob_id, (found, scan) in done.items():
        if blob_id not in md5s:
            await _keep_scan(context, blob_id, scan)
            async with context.database.begin() as db:
                await service.keep_examined(db, {}, {blob_id: found.md5})


async def _read_or_damaged(job_context: JobContext, context: AppContext, row: Row[tuple[object, ...]]) -> _Read | None:
    """Read a blob through, or keep that it is lost or corrupt and return None.

    Raises:
        StoreUnavailable: the store is away, or does not give it now: to be tried again.
    """
    try:
        found, scan = await _read(context, given(job_context, "readers", Readers), row)
    except FileNotFoundError:
        await _keep_damage(context, row.id, BlobState.lost, "the store no longer has the object")
        return None
    except Unreadable as error:
        await _keep_damage(context, row.id, BlobState.corrupt, str(error))
        async with context.database.begin() as db:
            await service.verify_tomorrow(db, row.id)
        return None
    except StoreUnavailable as error:
        await context.storage.check()  # raises when the store is away: then the blob is not to blame
        if job_context.job.attempts < ATTEMPTS - 1:
            raise
        await _keep_damage(context, row.id, BlobState.corrupt, f"the store cannot read it back ({error.reason})")
        return None
    if difference := found.differs_from(row):
        await _keep_damage(context, row.id, BlobState.corrupt, difference)
        return None
    return found, scan


async def _keep_scan(context: AppContext, blob_id: uuid.UUID, scan: RecordingSummary | SummaryFailed | None) -> None:
    if isinstance(scan, RecordingSummary):
        await _keep_summary(context, blob_id, scan)
    elif scan is not None:
        _log.warning("not scanned", extra={"fields": {"blob_id": str(blob_id), "reason": str(scan)}})
        async with context.database.begin() as db:
            await service.keep_failure(db, blob_id, str(scan))


async def _read(context: AppContext, readers: Readers, row: Row[tuple[object, ...]]) -> _Read:
    """Read a blob through. What reading along failed at is no reason to doubt the bytes."""
    if logs := await _logs_beside(context, row):
        found = await read_through(context, row.key)
        try:
            return found, await _summary(context, readers, row, logs)
        except SummaryFailed as failure:
            return found, failure
    if row.path is None or row.content == ContentState.opaque or row.depth == ReadDepth.scan:
        return await read_through(context, row.key), None
    patience_s = context.settings.summary_timeout_s
    request = stream_request_bytes(
        StreamRequest(row.size_bytes, file_name(row.path)),
        memory_bytes=context.settings.summary_memory_bytes,
        timeout_s=round(patience_s) + row.size_bytes // _SCAN_BYTES_PER_S,
    )
    async with readers.reading_along(request, owner=row.uploaded_by_id, patience_s=patience_s) as child:
        found = await read_through(context, row.key, child.feed)
        if found.size_bytes != row.size_bytes:  # the child was given something else than was announced
            return found, None
        try:
            return found, await child.summary()
        except SummaryFailed as failure:
            return found, failure


async def _keep_damage(context: AppContext, blob_id: uuid.UUID, state: BlobState, reason: str) -> None:
    _log.error("blob damaged", extra={"fields": {"blob_id": str(blob_id), "state": state.value, "reason": reason}})
    async with context.database.begin() as db:
        await service.keep_damage(db, blob_id, state=state, reason=reason)


@queue.periodic(cron="*/10 * * * *")
@queue.task(name=Job.sweep.value, pass_context=True, queueing_lock="sweep", lock="sweep")
async def sweep(job_context: JobContext, timestamp: int = 0) -> None:
    """Take up what was forgotten, and let go of what left the trash: rows first, then what nothing refers to."""
    await sweep_once(app_context(job_context))


async def sweep_once(context: AppContext) -> None:
    """Do one round of the sweep; what a round leaves, the next one takes."""
    async with context.database.begin() as db:
        await service.examine_forgotten(db, store_id=context.settings.store_id, limit=_SWEEP_BATCH)
        await regroup_forgotten(db, limit=_SWEEP_BATCH)
    async with context.database.begin() as db:
        days = context.settings.reverify_days
        await service.examine_old(db, store_id=context.settings.store_id, older_than_days=days, limit=_MAX_REVERIFIED)
        await scrubs.begin_due_scrub(db, context.settings)
    async with context.database.begin() as db:
        await forget_ended(db)
        await delete_expired_counts(db)
        await empty_trash(db, older_than_days=context.settings.trash_days, limit=_SWEEP_BATCH)
    async with context.database.begin() as db:
        await service.doom_unreferenced(db, limit=_SWEEP_BATCH)
    async with context.database.begin() as db:
        # After the dooming, so that what a backup saw undoomed is not taken from it.
        if await is_held_back(db):
            return
        doomed = await service.doomed_blobs(
            db, store_id=context.settings.store_id, grace_s=context.settings.sweep_grace_s, limit=_SWEEP_BATCH
        )
    for row in doomed:
        await context.storage.delete(row.key)
        async with context.database.begin() as db:
            await service.forget_blob(db, row.id)


@queue.task(name=Job.scrub.value, retry=PATIENTLY, pass_context=True)
async def scrub(job_context: JobContext, ref: str) -> None:
    """Compare what the store lists with what the database knows."""
    context, scrub_id = app_context(job_context), uuid.UUID(ref)
    try:
        await scrub_store(context, scrub_id)
    except StoreUnavailable as error:
        if job_context.job.attempts < ATTEMPTS - 1:
            raise
        async with context.database.begin() as db:
            stopped = f"The scrub came to no end: {error.sentence()}"
            await scrubs.end(db, scrub_id, scrubs.Tally(), stopped=stopped)
