"""What happens to blobs after they arrived: queueing their jobs, and recording what reading them showed."""

import datetime
import uuid
from collections.abc import Iterable, Mapping, Sequence

from sqlalchemy import func, select, text, update

from kleinkram.contract.files import BlobState
from kleinkram.recordings import RecordingSummary
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs import queries
from kleinkram.server.blobs.queries import BlobRow, SqliteLog
from kleinkram.server.blobs.summaries import publish_file_changes, record_summaries
from kleinkram.server.db import Connection, among, unnest_rows
from kleinkram.server.jobs.queue import Job, Priority, delete_waiting, enqueue, has_job, start_now, waiting_ids
from kleinkram.server.tables import blob, file, mission

_TOMORROW = datetime.timedelta(days=1)
_COUNT_REVERIFICATIONS = text(
    "SELECT count(*) FROM procrastinate_jobs WHERE task_name = 'verify_blob' AND status = 'todo' AND priority < 0"
)


# -- queueing jobs ----------------------------------------------------------------------------------------------------


async def examine_blobs(db: Connection, blob_ids: Sequence[uuid.UUID]) -> None:
    """Queue the jobs of new blobs: a summary soon and a verification in time; for a small blob, one job for both.

    A database whose log is new is read again, together with the log.
    """
    databases = (await db.execute(queries.databases_with_logs(blob_ids))).scalars()
    blob_ids = [*dict.fromkeys([*blob_ids, *databases])]
    are_small = select(blob.c.id).where(among(blob.c.id, blob_ids), queries.is_small())
    small_ids = set((await db.execute(are_small)).scalars())
    small = [str(blob_id) for blob_id in blob_ids if blob_id in small_ids]
    large = [str(blob_id) for blob_id in blob_ids if blob_id not in small_ids]
    await enqueue(db, Job.examine_blob, ids=small, priority=Priority.high)
    await enqueue(db, Job.summarise_blob, ids=large, priority=Priority.high)
    await enqueue(db, Job.verify_blob, ids=large, priority=Priority.normal)


async def requeue_unfinished(db: Connection, *, store_id: str, limit: int) -> None:
    """Queue blobs again whose jobs gave up, for example because the store was away for long.

    A failed summary is tried again once a day.
    """
    is_small = queries.is_small()
    for job, is_due in (
        (Job.examine_blob, queries.is_unread() & is_small),
        (Job.examine_blob, queries.is_unverified() & is_small),
        (Job.summarise_blob, queries.is_unread() & ~is_small),
        (Job.verify_blob, queries.is_unverified() & ~is_small),
    ):
        statement = (
            select(blob.c.id)
            .where(
                blob.c.marked_for_deletion_at.is_(None), is_due, blob.c.store_id == store_id, ~has_job(job, blob.c.id)
            )
            .order_by(blob.c.created_at)
            .limit(limit)
        )
        ids = [str(blob_id) for blob_id in (await db.execute(statement)).scalars()]
        await enqueue(db, job, ids=ids, priority=Priority.normal)


async def examine_old(db: Connection, *, store_id: str, older_than_days: int, limit: int) -> None:
    """Queue blobs for another verification, the oldest first, to be done when nothing else is to be verified.

    At most `limit` are queued at a time.
    """
    room = limit - (await db.execute(_COUNT_REVERIFICATIONS)).scalar_one()
    if older_than_days == 0 or room <= 0:
        return
    due = (
        select(blob.c.id)
        .where(
            blob.c.marked_for_deletion_at.is_(None),
            blob.c.state == BlobState.verified.value,
            blob.c.verified_at < func.now() - datetime.timedelta(days=older_than_days),
            blob.c.store_id == store_id,
            ~has_job(Job.verify_blob, blob.c.id),
        )
        .order_by(blob.c.verified_at)
        .limit(room)
    )
    ids = [str(blob_id) for blob_id in (await db.execute(due)).scalars()]
    await enqueue(db, Job.verify_blob, ids=ids, priority=Priority.low)


async def verify_again(db: Connection, blob_id: uuid.UUID) -> None:
    """Queue a blob for verification ahead of routine work; a job that is queued already is only moved forward."""
    queued = select(blob.c.id).where(blob.c.id == blob_id, has_job(Job.verify_blob, blob.c.id))
    if (await db.execute(queued)).first() is not None:
        await start_now(db, Job.verify_blob, blob_id)
        return
    await enqueue(db, Job.verify_blob, ids=[str(blob_id)], priority=Priority.high)


async def verify_tomorrow(db: Connection, blob_id: uuid.UUID) -> None:
    """Queue a blob that the store failed to return for one more verification: the store may have been at fault."""
    await enqueue(db, Job.verify_blob, ids=[str(blob_id)], priority=Priority.low, later=_TOMORROW)


# -- reading rows -----------------------------------------------------------------------------------------------------


async def find_blob(db: Connection, blob_id: uuid.UUID) -> BlobRow | None:
    """Return a blob that exists and is not marked for deletion."""
    row = (await db.execute(queries.blobs_with_path([blob_id]))).one_or_none()
    return None if row is None else BlobRow._make(row)


async def find_sqlite_logs(db: Connection, blob_id: uuid.UUID) -> dict[str, SqliteLog]:
    """Return, by suffix, the log and journal beside a database."""
    return {row.suffix: SqliteLog._make(row) for row in await db.execute(queries.sqlite_logs(blob_id))}


async def queued_small_blobs(db: Connection, first: BlobRow, *, limit: int) -> list[BlobRow]:
    """Return small blobs that are queued to be examined, of the same person and store as `first`."""
    ids = await waiting_ids(db, Job.examine_blob, most=limit)
    is_alike = (blob.c.uploaded_by_id == first.uploaded_by_id) & (blob.c.store_id == first.store_id)
    statement = queries.blobs_with_path(ids).where(is_alike, blob.c.id != first.id)
    return [BlobRow._make(row) for row in await db.execute(statement)]


# -- recording results ------------------------------------------------------------------------------------------------


async def record_verified(db: Connection, md5s: Mapping[uuid.UUID, bytes]) -> None:
    """Record that the server has read blobs and confirmed their SHA-256, with the MD5 of each.

    A blob that was damaged is sound again.
    """
    repaired = await _lock_damaged(db, md5s)
    rows = unnest_rows([blob.c.id, blob.c.md5], [{"id": blob_id, "md5": md5} for blob_id, md5 in md5s.items()])
    values = {"state": BlobState.verified.value, "state_reason": None, "damaged_at": None, "md5": rows.c.md5}
    await db.execute(update(blob).where(blob.c.id == rows.c.id).values(**values, verified_at=func.now()))
    for blob_id, before in repaired.items():
        await _audit_files(db, blob_id, "file.recover", {"state": before}, {"state": BlobState.verified.value})
    await publish_file_changes(db, md5s)


async def record_examined(
    db: Connection, summaries: Mapping[uuid.UUID, RecordingSummary], md5s: Mapping[uuid.UUID, bytes]
) -> None:
    """Record summaries and verifications of small blobs, and drop the jobs that were queued for them."""
    await record_summaries(db, summaries)
    await record_verified(db, md5s)
    await delete_waiting(db, Job.examine_blob, md5s)


async def record_damage(db: Connection, blob_id: uuid.UUID, *, state: BlobState, reason: str) -> bool:
    """Record that a blob is lost or corrupt, and how that showed; return whether that is new.

    Nothing is recorded of a blob that is marked for deletion: its object may be gone already.
    """
    before = (await _lock_damaged(db, [blob_id])).get(blob_id)
    values = {"state": state.value, "state_reason": reason, "damaged_at": func.coalesce(blob.c.damaged_at, func.now())}
    mark = update(blob).where(blob.c.id == blob_id, blob.c.marked_for_deletion_at.is_(None)).values(**values)
    if (await db.execute(mark)).rowcount == 0 or before == state.value:
        return False
    await _audit_files(db, blob_id, "file.damage", {}, {"state": state.value, "reason": reason})
    await publish_file_changes(db, [blob_id])
    return True


async def _lock_damaged(db: Connection, blob_ids: Iterable[uuid.UUID]) -> dict[uuid.UUID, str]:
    """Lock the damaged blobs among these and return their states."""
    is_damaged = blob.c.state.in_((BlobState.lost.value, BlobState.corrupt.value))
    damaged = select(blob.c.id, blob.c.state).where(among(blob.c.id, blob_ids), is_damaged)
    return {row.id: row.state for row in await db.execute(damaged.order_by(blob.c.id).with_for_update())}


async def _audit_files(
    db: Connection, blob_id: uuid.UUID, operation: str, before: dict[str, str], after: dict[str, str]
) -> None:
    """Add an audit event for each file of a blob outside the trash."""
    columns = (file.c.id, file.c.path, file.c.mission_id, mission.c.project_id)
    files = select(*columns).join_from(file, mission).where(file.c.blob_id == blob_id, file.c.deleted_at.is_(None))
    events = [
        Event(operation, "file", row.id, row.path, row.project_id, {**before}, {**after}, row.mission_id)
        for row in await db.execute(files)
    ]
    await audit(db, None, *events)
