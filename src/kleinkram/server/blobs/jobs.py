"""Jobs on blobs: read the summary by ranges, verify the bytes, compare the store's listing with the database.

A small blob is read once, whole, for summary and verification; many are read in a row and recorded in one transaction,
because a job each would cost a hundred times what reading one does.
"""

import logging
import time
import uuid
from collections.abc import Mapping
from typing import NamedTuple

from procrastinate import JobContext
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
from kleinkram.server.blobs import scrub, service
from kleinkram.server.blobs.queries import BlobRow, SqliteLog
from kleinkram.server.blobs.reader_processes import ReaderProcesses
from kleinkram.server.blobs.summaries import record_read_failure, record_summaries
from kleinkram.server.blobs.verification import ObjectChecksums, Unreadable, read_through
from kleinkram.server.context import AppContext
from kleinkram.server.jobs.execution import (
    ATTEMPTS,
    RETRY_STRATEGY,
    SUMMARY_MAX_WAIT_S,
    VERIFY_MAX_WAIT_S,
    app_context,
    back_pressure_of,
    worker_resource,
)
from kleinkram.server.jobs.queue import Job, Priority, queue, raise_priority

_log = logging.getLogger("kleinkram.blobs")
# A recording without an index must be read whole: at once up to this size, else when the verification reads it.
_SUMMARY_MOST_BYTES = 64 * 1024 * 1024
# Slower than the slowest format is read on any known machine.
_SCAN_BYTES_PER_S = 5_000_000
_DATABASE_SUFFIX = ".db3"
# One transaction records at most this many small blobs, read within this time; less while uploads are active.
_BATCH_BLOBS, _BATCH_S, _BATCH_WITH_UPLOADS_S = 100, 2.0, 0.02


class _ReadResult(NamedTuple):
    """The checksums of a blob, and the result of the child process that parsed it; None if it was not parsed."""

    checksums: ObjectChecksums
    scan: RecordingSummary | SummaryFailed | None


@queue.task(name=Job.summarise_blob.value, retry=RETRY_STRATEGY, pass_context=True)
async def summarise_blob(job_context: JobContext, ref: str) -> None:
    """Read what is in a recording, in a child process without credentials, and keep it."""
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    row = await _find_in_own_store(context, blob_id)
    if row is None or row.path is None:
        return
    logs = await _sqlite_logs(context, row)
    if row.depth == ReadDepth.scan and not logs:
        return
    await back_pressure_of(job_context).wait_for_uploads(SUMMARY_MAX_WAIT_S, since=row.created_at)
    try:
        summary = await _summary(context, worker_resource(job_context, "readers", ReaderProcesses), row, logs)
    except SummaryFailed as failure:
        if failure.kind is FailureKind.source and job_context.job.attempts < ATTEMPTS - 1:
            raise  # the store, not the file: worth another try
        async with context.database.begin() as db:
            await record_read_failure(db, blob_id, str(failure))
        return
    await _record_summary(context, blob_id, summary)
    if summary.content is Content.pending:  # only the verification reads it: somebody may wait for that
        async with context.database.begin() as db:
            await raise_priority(db, Job.verify_blob, blob_id)


async def _find_in_own_store(context: AppContext, blob_id: uuid.UUID) -> BlobRow | None:
    """Return a blob that is still wanted, and whose bytes are in this server's own store."""
    async with context.database.begin() as db:
        row = await service.find_blob(db, blob_id)
    return row if row is not None and row.store_id == context.settings.store_id else None


async def _record_summary(context: AppContext, blob_id: uuid.UUID, summary: RecordingSummary) -> None:
    try:
        async with context.database.begin() as db:
            await record_summaries(db, {blob_id: summary})
    except (DataError, IntegrityError) as error:  # a file may say what no column holds
        _log.error("summary not kept", extra={"fields": {"blob_id": str(blob_id), "reason": str(error.orig)}})
        async with context.database.begin() as db:
            await record_read_failure(db, blob_id, "what it says of itself does not fit into the database")


async def _sqlite_logs(context: AppContext, row: BlobRow) -> Mapping[str, SqliteLog]:
    if row.path is None or not row.path.endswith(_DATABASE_SUFFIX):
        return {}
    async with context.database.begin() as db:
        return await service.find_sqlite_logs(db, row.id)


async def _summary(
    context: AppContext,
    readers: ReaderProcesses,
    row: BlobRow,
    logs: Mapping[str, SqliteLog],
) -> RecordingSummary:
    size_bytes = row.size_bytes + sum(log.size_bytes for log in logs.values())
    timeout_s = context.settings.summary_timeout_s + (size_bytes // _SCAN_BYTES_PER_S if logs else 0)

    def sign(key: str) -> str:
        return context.storage.sign_internal_get(key, expires_s=timeout_s + 60)

    log_sources = {suffix: (sign(log.key), log.size_bytes) for suffix, log in logs.items()}
    request = request_bytes(
        UrlRequest(sign(row.key), row.size_bytes, file_name(row.path or ""), log_sources),
        most_bytes=_SUMMARY_MOST_BYTES,
        memory_bytes=context.settings.summary_memory_bytes,
        timeout_s=round(timeout_s),
    )
    return await readers.summary(request, owner=row.uploaded_by_id, timeout_s=timeout_s)


@queue.task(name=Job.verify_blob.value, retry=RETRY_STRATEGY, pass_context=True)
async def verify_blob(job_context: JobContext, ref: str) -> None:
    """Read a blob once, at a limited rate, and compare it with what was stated of it when it came.

    A child process without credentials reads along, and says what the whole of a recording holds.
    """
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    row = await _find_in_own_store(context, blob_id)
    if row is None:
        return
    # What is only verified again gives way from now on, whenever it came.
    anew = job_context.job.priority < Priority.normal
    await back_pressure_of(job_context).wait_for_uploads(VERIFY_MAX_WAIT_S, since=None if anew else row.created_at)
    read = await _read_or_damaged(job_context, context, row)
    if read is None:
        return
    checksums, scan = read
    # Stored last: until then a recording that only this job reads counts as pending.
    await _record_scan(context, blob_id, scan)
    async with context.database.begin() as db:
        await service.record_verified(db, {blob_id: checksums.md5})


@queue.task(name=Job.examine_blob.value, retry=RETRY_STRATEGY, pass_context=True)
async def examine_blob(job_context: JobContext, ref: str) -> None:
    """Read a small blob for all that is to be known of it, and with it others of the same person that wait."""
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    row = await _find_in_own_store(context, blob_id)
    if row is None:
        return
    are_uploads_active = await back_pressure_of(job_context).wait_for_uploads(SUMMARY_MAX_WAIT_S, since=row.created_at)
    until = time.monotonic() + (_BATCH_WITH_UPLOADS_S if are_uploads_active else _BATCH_S)
    read = await _read_or_damaged(job_context, context, row)
    if read is None:
        async with context.database.begin() as db:
            await record_read_failure(db, blob_id, "its bytes are damaged or gone")
        return
    done = {blob_id: read}
    async with context.database.begin() as db:
        others = await service.queued_small_blobs(db, row, limit=_BATCH_BLOBS)
    for other in others:
        if time.monotonic() > until:
            break
        try:
            read = await _read(context, worker_resource(job_context, "readers", ReaderProcesses), other)
        except (FileNotFoundError, Unreadable):
            continue  # its own job will say so, as of those that were altered
        except StoreUnavailable:
            break
        if read.checksums.differs_from(other) is None:
            done[other.id] = read
    await _record_examined(context, done)


async def _record_examined(context: AppContext, done: Mapping[uuid.UUID, _ReadResult]) -> None:
    summaries = {blob_id: scan for blob_id, (_, scan) in done.items() if isinstance(scan, RecordingSummary)}
    md5s = {
        blob_id: checksums.md5 for blob_id, (checksums, scan) in done.items() if not isinstance(scan, SummaryFailed)
    }
    try:
        async with context.database.begin() as db:
            await service.record_examined(db, summaries, md5s)
    except (DataError, IntegrityError):  # one of them says what no column holds
        summaries, md5s = {}, {}
    for blob_id, (checksums, scan) in done.items():
        if blob_id not in md5s:
            await _record_scan(context, blob_id, scan)
            async with context.database.begin() as db:
                await service.record_examined(db, {}, {blob_id: checksums.md5})


async def _read_or_damaged(job_context: JobContext, context: AppContext, row: BlobRow) -> _ReadResult | None:
    """Read a blob through, or keep that it is lost or corrupt and return None.

    Raises:
        StoreUnavailable: the store is away, or does not give it now: to be tried again.
    """
    try:
        checksums, scan = await _read(context, worker_resource(job_context, "readers", ReaderProcesses), row)
    except FileNotFoundError:
        await _record_damage(context, row.id, BlobState.lost, "the store no longer has the object")
        return None
    except Unreadable as error:
        await _record_damage(context, row.id, BlobState.corrupt, str(error))
        async with context.database.begin() as db:
            await service.verify_tomorrow(db, row.id)
        return None
    except StoreUnavailable as error:
        await context.storage.check()  # raises when the store is away: then the blob is not to blame
        if job_context.job.attempts < ATTEMPTS - 1:
            raise
        await _record_damage(context, row.id, BlobState.corrupt, f"the store cannot read it back ({error.reason})")
        return None
    if difference := checksums.differs_from(row):
        await _record_damage(context, row.id, BlobState.corrupt, difference)
        return None
    return _ReadResult(checksums, scan)


async def _record_scan(context: AppContext, blob_id: uuid.UUID, scan: RecordingSummary | SummaryFailed | None) -> None:
    if isinstance(scan, RecordingSummary):
        await _record_summary(context, blob_id, scan)
    elif scan is not None:
        _log.warning("not scanned", extra={"fields": {"blob_id": str(blob_id), "reason": str(scan)}})
        async with context.database.begin() as db:
            await record_read_failure(db, blob_id, str(scan))


async def _read(context: AppContext, readers: ReaderProcesses, row: BlobRow) -> _ReadResult:
    """Read a blob through. What reading along failed at is no reason to doubt the bytes."""
    if logs := await _sqlite_logs(context, row):
        checksums = await read_through(context, row.key)
        try:
            return _ReadResult(checksums, await _summary(context, readers, row, logs))
        except SummaryFailed as failure:
            return _ReadResult(checksums, failure)
    if row.path is None or row.content == ContentState.opaque or row.depth == ReadDepth.scan:
        return _ReadResult(await read_through(context, row.key), None)
    patience_s = context.settings.summary_timeout_s
    request = stream_request_bytes(
        StreamRequest(row.size_bytes, file_name(row.path)),
        memory_bytes=context.settings.summary_memory_bytes,
        timeout_s=round(patience_s) + row.size_bytes // _SCAN_BYTES_PER_S,
    )
    async with readers.parse_stream(request, owner=row.uploaded_by_id, patience_s=patience_s) as child:
        checksums = await read_through(context, row.key, child.feed)
        if checksums.size_bytes != row.size_bytes:  # the child was given something else than was announced
            return _ReadResult(checksums, None)
        try:
            return _ReadResult(checksums, await child.summary())
        except SummaryFailed as failure:
            return _ReadResult(checksums, failure)


async def _record_damage(context: AppContext, blob_id: uuid.UUID, state: BlobState, reason: str) -> None:
    _log.error("blob damaged", extra={"fields": {"blob_id": str(blob_id), "state": state.value, "reason": reason}})
    async with context.database.begin() as db:
        await service.record_damage(db, blob_id, state=state, reason=reason)


@queue.task(name=Job.scrub.value, retry=RETRY_STRATEGY, pass_context=True)
async def scrub_blobs(job_context: JobContext, ref: str) -> None:
    """Compare what the store lists with what the database knows."""
    context, scrub_id = app_context(job_context), uuid.UUID(ref)
    try:
        await scrub.scrub_store(context, scrub_id)
    except StoreUnavailable as error:
        if job_context.job.attempts < ATTEMPTS - 1:
            raise
        async with context.database.begin() as db:
            stopped = f"The scrub came to no end: {error.sentence()}"
            await scrub.end(db, scrub_id, scrub.ScrubCounts(), aborted_reason=stopped)
