"""Jobs on blobs: read summaries, verify bytes, scrub the store, collect garbage.

A large blob has two jobs: one reads its summary by ranges, one verifies all bytes. A small blob is read once for both;
one job reads many and records them in one transaction, because a job costs a hundred times as much as reading one.
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
from kleinkram.recordings import Content, FailureKind, RecordingSummary, SummaryFailed
from kleinkram.recordings.isolation import StreamRequest, UrlRequest, request_bytes
from kleinkram.server.blobs import recording_previews, scrub, service
from kleinkram.server.blobs.queries import BlobRow, SqliteLog
from kleinkram.server.blobs.readers import ObjectChecksums, ReaderProcesses, Unreadable, read_through
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
# A recording without an index must be read completely: up to this size by the summary, else by the verification.
_SUMMARY_MOST_BYTES = 64 * 1024 * 1024
# Below the speed of the slowest format on any known machine.
_SCAN_BYTES_PER_S = 5_000_000
_DATABASE_SUFFIX = ".db3"
# Batch limits of one transaction: number of small blobs, and time to read them; less time during uploads.
_BATCH_BLOBS, _BATCH_S, _BATCH_WITH_UPLOADS_S = 100, 2.0, 0.02


class _ReadResult(NamedTuple):
    """The checksums of a blob, and the result of the child process that parsed it; None if it was not parsed."""

    checksums: ObjectChecksums
    scan: RecordingSummary | SummaryFailed | None


@queue.task(name=Job.summarise_blob.value, retry=RETRY_STRATEGY, pass_context=True)
async def summarise_blob(job_context: JobContext, ref: str) -> None:
    """Read the summary of a recording in a child process without credentials, and record it."""
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
            raise  # the store failed, not the file: try again
        async with context.database.begin() as db:
            await service.record_read_failure(db, blob_id, str(failure))
        return
    await _record_summary(context, blob_id, summary)
    if summary.content is Content.pending:  # only the verification reads it, and a user may wait for that
        async with context.database.begin() as db:
            await raise_priority(db, Job.verify_blob, blob_id)


async def _find_in_own_store(context: AppContext, blob_id: uuid.UUID) -> BlobRow | None:
    """Return a blob that is not marked for deletion and is in this server's own store."""
    async with context.database.begin() as db:
        row = await service.find_blob(db, blob_id)
    return row if row is not None and row.store_id == context.settings.store_id else None


async def _record_summary(context: AppContext, blob_id: uuid.UUID, summary: RecordingSummary) -> None:
    try:
        async with context.database.begin() as db:
            await service.record_summaries(db, {blob_id: summary})
            if context.settings.recording_previews:
                await recording_previews.enqueue_new(db, blob_id)
    except (DataError, IntegrityError) as error:  # untrusted values may fit no column
        _log.error("summary not recorded", extra={"fields": {"blob_id": str(blob_id), "reason": str(error.orig)}})
        async with context.database.begin() as db:
            await service.record_read_failure(db, blob_id, "its metadata does not fit into the database")


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
        max_bytes=_SUMMARY_MOST_BYTES,
        memory_bytes=context.settings.summary_memory_bytes,
        timeout_s=round(timeout_s),
    )
    return await readers.summary(request, owner=row.uploaded_by_id, timeout_s=timeout_s)


@queue.task(name=Job.verify_blob.value, retry=RETRY_STRATEGY, pass_context=True)
async def verify_blob(job_context: JobContext, ref: str) -> None:
    """Read a blob completely, at a limited rate, and compare its checksums with those of its upload.

    A child process without credentials receives the bytes, too, and returns the summary of a recording.
    """
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    row = await _find_in_own_store(context, blob_id)
    if row is None:
        return
    # The wait of a routine re-verification begins now, not at the upload.
    is_routine = job_context.job.priority < Priority.normal
    await back_pressure_of(job_context).wait_for_uploads(
        VERIFY_MAX_WAIT_S, since=None if is_routine else row.created_at
    )
    read = await _read_or_damaged(job_context, context, row)
    if read is None:
        return
    checksums, scan = read
    # Recorded before the verification: until then, a recording that only this job reads is pending.
    await _record_scan(context, blob_id, scan)
    async with context.database.begin() as db:
        await service.record_verified(db, {blob_id: checksums.md5})


@queue.task(name=Job.summarise_and_verify_blob.value, retry=RETRY_STRATEGY, pass_context=True)
async def summarise_and_verify_blob(job_context: JobContext, ref: str) -> None:
    """Read the summary of a small blob and verify it, and with it queued ones of the same person."""
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    row = await _find_in_own_store(context, blob_id)
    if row is None:
        return
    are_uploads_active = await back_pressure_of(job_context).wait_for_uploads(SUMMARY_MAX_WAIT_S, since=row.created_at)
    until = time.monotonic() + (_BATCH_WITH_UPLOADS_S if are_uploads_active else _BATCH_S)
    read = await _read_or_damaged(job_context, context, row)
    if read is None:
        async with context.database.begin() as db:
            await service.record_read_failure(db, blob_id, "its bytes are damaged or missing")
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
            continue  # its own job records the damage
        except StoreUnavailable:
            break
        if read.checksums.differs_from(other) is None:
            done[other.id] = read
    await _record_small_blobs(context, done)


async def _record_small_blobs(context: AppContext, done: Mapping[uuid.UUID, _ReadResult]) -> None:
    summaries = {blob_id: scan for blob_id, (_, scan) in done.items() if isinstance(scan, RecordingSummary)}
    md5s = {
        blob_id: checksums.md5 for blob_id, (checksums, scan) in done.items() if not isinstance(scan, SummaryFailed)
    }
    try:
        async with context.database.begin() as db:
            await service.record_small_blobs(db, summaries, md5s)
    except (DataError, IntegrityError):  # values of one of them fit no column
        summaries, md5s = {}, {}
    for blob_id, (checksums, scan) in done.items():
        if blob_id not in md5s:
            await _record_scan(context, blob_id, scan)
            async with context.database.begin() as db:
                await service.record_small_blobs(db, {}, {blob_id: checksums.md5})


async def _read_or_damaged(job_context: JobContext, context: AppContext, row: BlobRow) -> _ReadResult | None:
    """Read a blob completely; return None if it is lost or corrupt, which is recorded.

    Raises:
        StoreUnavailable: the store did not answer: try again.
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
        await context.storage.check()  # raises if the store fails as a whole
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
            await service.record_read_failure(db, blob_id, str(scan))


async def _read(context: AppContext, readers: ReaderProcesses, row: BlobRow) -> _ReadResult:
    """Read and parse a blob. A failure of the parser does not concern the checksums."""
    if logs := await _sqlite_logs(context, row):
        checksums = await read_through(context, row.key)
        try:
            return _ReadResult(checksums, await _summary(context, readers, row, logs))
        except SummaryFailed as failure:
            return _ReadResult(checksums, failure)
    if row.path is None or row.content == ContentState.opaque or row.depth == ReadDepth.scan:
        return _ReadResult(await read_through(context, row.key), None)
    timeout_s = context.settings.summary_timeout_s
    request = request_bytes(
        StreamRequest(row.size_bytes, file_name(row.path)),
        memory_bytes=context.settings.summary_memory_bytes,
        timeout_s=round(timeout_s) + row.size_bytes // _SCAN_BYTES_PER_S,
    )
    async with readers.parse_stream(request, owner=row.uploaded_by_id, timeout_s=timeout_s) as child:
        checksums = await read_through(context, row.key, child.feed)
        if checksums.size_bytes != row.size_bytes:  # the child received another number of bytes than announced
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
    """Compare the store's listing with the database."""
    context, scrub_id = app_context(job_context), uuid.UUID(ref)
    try:
        await scrub.scrub_store(context, scrub_id)
    except StoreUnavailable as error:
        if job_context.job.attempts < ATTEMPTS - 1:
            raise
        async with context.database.begin() as db:
            aborted_reason = f"The scrub could not be finished: {error.sentence()}"
            await scrub.end(db, scrub_id, scrub.ScrubCounts(), aborted_reason=aborted_reason)
