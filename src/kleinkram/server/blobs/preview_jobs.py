"""The job that makes the preview of a recording, in a child process without credentials.

It is independent of the verification: whatever fails here concerns the preview alone.
"""

import signal
import uuid
from dataclasses import replace

from procrastinate import JobContext

from kleinkram.contract.names import file_name
from kleinkram.contract.recording_previews import RecordingPreviewState
from kleinkram.recordings import FailureKind, SummaryFailed
from kleinkram.recordings.isolation import PreviewAnswer, PreviewRequest, request_bytes
from kleinkram.server.blobs import recording_previews, service
from kleinkram.server.blobs.queries import BlobRow
from kleinkram.server.blobs.readers import ReaderProcesses
from kleinkram.server.context import AppContext
from kleinkram.server.jobs.execution import (
    ATTEMPTS,
    RETRY_STRATEGY,
    VERIFY_MAX_WAIT_S,
    app_context,
    back_pressure_of,
    worker_resource,
)
from kleinkram.server.jobs.queue import Job, queue

MAX_PREVIEW_BYTES = 20 * 10**6
MAX_THUMBNAIL_BYTES = 32 * 1024
# A recording without a usable index is read whole to be opened, up to this size.
_MAX_SCAN_BYTES = 2**30
# Below the speed of the slowest format on any known machine; of a recording above 4 GiB, about as much is read.
_BYTES_PER_S, _MAX_READ_BYTES = 5_000_000, 4 * 2**30

# A busy machine, or a store that was away: tried once more after a day.
_TEMPORARY = frozenset((FailureKind.time, FailureKind.memory, FailureKind.source))


@queue.task(name=Job.make_recording_preview.value, retry=RETRY_STRATEGY, pass_context=True)
async def make_recording_preview(job_context: JobContext, ref: str) -> None:
    """Make the preview of a recording and store it beside the blob; an earlier one is replaced."""
    context, blob_id = app_context(job_context), uuid.UUID(ref)
    async with context.database.begin() as db:
        row = await service.find_blob(db, blob_id)
        before = await recording_previews.find_preview(db, blob_id)
    if row is None or not _is_due(context, row, before):
        return
    await back_pressure_of(job_context).wait_for_uploads(VERIFY_MAX_WAIT_S, since=row.created_at)
    if before is not None and before.key is not None:
        await context.storage.delete(before.key)
    key = f"previews/{blob_id}/{uuid.uuid4().hex[:12]}"
    async with context.database.begin() as db:
        if not await recording_previews.record_begin(db, blob_id, key=key):
            return
    try:
        made = await _make(context, worker_resource(job_context, "readers", ReaderProcesses), row)
    except SummaryFailed as failure:
        if failure.kind is FailureKind.source and job_context.job.attempts < ATTEMPTS - 1:
            raise  # the store failed, not the file: try again
        async with context.database.begin() as db:
            await recording_previews.record_failure(
                db, blob_id, key=key, reason=str(failure), temporary_failures=_temporary_failures(failure, before)
            )
        return
    await context.storage.put_object(key, made.data)
    async with context.database.begin() as db:
        is_recorded = await recording_previews.record_ready(db, blob_id, key=key, preview=made)
    if not is_recorded:
        await context.storage.delete(key)


def _is_due(context: AppContext, row: BlobRow, before: recording_previews.RecordingPreviewRow | None) -> bool:
    """Whether a preview is to be made: one that was requested has the state `making` already."""
    is_readable = row.path is not None and row.content in recording_previews.READABLE
    if row.store_id != context.settings.store_id or not is_readable:
        return False
    if before is None:
        return context.settings.recording_previews
    return before.state != RecordingPreviewState.deleted.value


def _temporary_failures(failure: SummaryFailed, before: recording_previews.RecordingPreviewRow | None) -> int:
    """Return the number of temporary failures in succession, this one included; 0 if this one would happen again."""
    is_temporary = failure.kind in _TEMPORARY or failure.signal == signal.SIGKILL
    return (before.temporary_failures if before is not None else 0) + 1 if is_temporary else 0


async def _make(context: AppContext, readers: ReaderProcesses, row: BlobRow) -> PreviewAnswer:
    """Return a preview, which the child may have falsified: only sizes and the range of the position are checked."""
    async with context.database.begin() as db:
        logs = await service.find_sqlite_logs(db, row.id)
    size_bytes = row.size_bytes + sum(log.size_bytes for log in logs.values())
    if logs and size_bytes > _MAX_SCAN_BYTES:
        message = f"with its log it has {size_bytes:,} bytes, and at most {_MAX_SCAN_BYTES:,} are read"
        raise SummaryFailed(message, kind=FailureKind.crash)
    timeout_s = context.settings.summary_timeout_s + min(size_bytes, _MAX_READ_BYTES) // _BYTES_PER_S

    def sign(key: str) -> str:
        return context.storage.sign_internal_get(key, expires_s=timeout_s + 60)

    log_sources = {suffix: (sign(log.key), log.size_bytes) for suffix, log in logs.items()}
    request = request_bytes(
        PreviewRequest(sign(row.key), row.size_bytes, file_name(row.path or ""), log_sources),
        max_bytes=_MAX_SCAN_BYTES,
        memory_bytes=context.settings.summary_memory_bytes,
        timeout_s=round(timeout_s),
    )
    made = await readers.preview(request, owner=row.uploaded_by_id, timeout_s=timeout_s)
    if len(made.data) > MAX_PREVIEW_BYTES:
        raise SummaryFailed(f"it has {len(made.data)} bytes", kind=FailureKind.crash)
    is_small = made.thumbnail is not None and len(made.thumbnail) <= MAX_THUMBNAIL_BYTES
    return made if is_small else replace(made, thumbnail=None)
