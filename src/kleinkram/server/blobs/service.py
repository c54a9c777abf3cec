"""What happens to blobs after they arrived: queueing their jobs, and recording what reading them showed.

Values of a recording are made to fit into the database's columns.
"""

import datetime
import math
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict

from sqlalchemy import bindparam, delete, func, insert, select, text, update

from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.files import BlobState, ContentState, ReadDepth
from kleinkram.recordings import RecordingSummary, TopicSummary
from kleinkram.recordings.message_density import pack
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs import queries
from kleinkram.server.blobs.queries import BlobRow, SqliteLog
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, among, fit_text, unnest_rows
from kleinkram.server.jobs.queue import Job, Priority, delete_waiting, enqueue, has_job, start_now, waiting_ids
from kleinkram.server.missions.service import lock_missions
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.tables import blob, file, mission, recording_preview, topic

_MAX_BIGINT = 2**63 - 1
_TOMORROW = datetime.timedelta(days=1)
_COUNT_REVERIFICATIONS = text(
    "SELECT count(*) FROM procrastinate_jobs WHERE task_name = 'verify_blob' AND status = 'todo' AND priority < 0"
)


# -- queueing jobs ----------------------------------------------------------------------------------------------------


async def enqueue_reading(db: Connection, blob_ids: Sequence[uuid.UUID]) -> None:
    """Queue the jobs of new blobs: a summary soon and a verification in time; for a small blob, one job for both.

    A database whose log is new is read again, together with the log.
    """
    databases = (await db.execute(queries.databases_with_logs(blob_ids))).scalars().all()
    # Their previews lack what is in the logs: as of an earlier version, they are made again after the summary.
    await db.execute(update(recording_preview).where(among(recording_preview.c.blob_id, databases)).values(version=0))
    blob_ids = [*dict.fromkeys([*blob_ids, *databases])]
    are_small = select(blob.c.id).where(among(blob.c.id, blob_ids), queries.is_small())
    small_ids = set((await db.execute(are_small)).scalars())
    small = [str(blob_id) for blob_id in blob_ids if blob_id in small_ids]
    large = [str(blob_id) for blob_id in blob_ids if blob_id not in small_ids]
    await enqueue(db, Job.summarise_and_verify_blob, ids=small, priority=Priority.high)
    await enqueue(db, Job.summarise_blob, ids=large, priority=Priority.high)
    await enqueue(db, Job.verify_blob, ids=large, priority=Priority.normal)


async def requeue_unfinished(db: Connection, *, store_id: str, limit: int) -> None:
    """Queue blobs again whose jobs gave up, for example because the store was unavailable for long.

    A failed summary is tried again once a day.
    """
    is_small = queries.is_small()
    for job, is_due in (
        (Job.summarise_and_verify_blob, queries.is_unread() & is_small),
        (Job.summarise_and_verify_blob, queries.is_unverified() & is_small),
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


async def verify_old(db: Connection, *, store_id: str, older_than_days: int, limit: int) -> None:
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
    """Return small blobs whose jobs are queued, of the same person and store as `first`."""
    ids = await waiting_ids(db, Job.summarise_and_verify_blob, most=limit)
    is_alike = (blob.c.uploaded_by_id == first.uploaded_by_id) & (blob.c.store_id == first.store_id)
    statement = queries.blobs_with_path(ids).where(is_alike, blob.c.id != first.id)
    return [BlobRow._make(row) for row in await db.execute(statement)]


# -- recording summaries ----------------------------------------------------------------------------------------------


async def record_summaries(db: Connection, summaries: Mapping[uuid.UUID, RecordingSummary]) -> None:
    """Replace what is known of the contents of blobs. The result of a scan is not replaced by a mere summary."""
    if not summaries:
        return
    await _lock_missions_of(db, summaries)
    locked = select(blob.c.id, blob.c.depth).where(among(blob.c.id, summaries)).order_by(blob.c.id).with_for_update()
    depths = {row.id: row.depth for row in await db.execute(locked)}
    better = {
        blob_id: summaries[blob_id]
        for blob_id, depth in depths.items()
        if depth != ReadDepth.scan.value or summaries[blob_id].depth.value == depth
    }
    if not better:
        return
    await db.execute(delete(topic).where(among(topic.c.blob_id, better)))
    topics = [_topic_columns(blob_id, one) for blob_id, summary in better.items() for one in summary.topics]
    if topics:
        await db.execute(insert(topic), topics)
    statement = update(blob).where(blob.c.id == bindparam("blob_id")).values(summarised_at=func.now())
    await db.execute(
        statement, [{"blob_id": blob_id, **_summary_columns(summary)} for blob_id, summary in better.items()]
    )
    await _derive_missions_of(db, better)


async def record_read_failure(db: Connection, blob_id: uuid.UUID, reason: str) -> None:
    """Record that reading a blob failed, and why; an earlier summary stays."""
    values = {"content": ContentState.error.value, "content_reason": fit_text(reason), "summarised_at": func.now()}
    await _lock_missions_of(db, [blob_id])
    has_no_summary = blob.c.content.in_((ContentState.pending.value, ContentState.error.value))
    await db.execute(update(blob).where(blob.c.id == blob_id, has_no_summary).values(**values))
    await _derive_missions_of(db, [blob_id])


def _summary_columns(summary: RecordingSummary) -> dict[str, object]:
    start_ns, end_ns = summary.start_ns, summary.end_ns
    if _bigint(start_ns) is None or _bigint(end_ns) is None:
        start_ns = end_ns = None  # one end of a time span is of no use
    return {
        "content": summary.content.value,
        "content_reason": fit_text(summary.reason),
        "format": summary.format.value,
        "message_count": _bigint(summary.message_count),
        "start_ns": start_ns,
        "end_ns": end_ns,
        "compression": [fit_text(name) for name in summary.compression],
        "problems": [{key: fit_text(value) for key, value in asdict(problem).items()} for problem in summary.problems],
        "depth": summary.depth.value,
        "lost": summary.lost and asdict(summary.lost),
        "facts": [{key: _fit_value(value) for key, value in asdict(fact).items()} for fact in summary.facts],
    }


def _fit_value(value: str | int | float) -> str | int | float:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON cannot express it
    return fit_text(value) if isinstance(value, str) else value


def _topic_columns(blob_id: uuid.UUID, summary: TopicSummary) -> dict[str, object]:
    values = asdict(summary)
    values.pop("suspect_count")
    values["density"] = pack(summary.density) if summary.density is not None else None
    texts = ("name", "message_type", "schema_name", "schema_encoding", "message_encoding")
    values |= {key: fit_text(values[key]) for key in texts}
    values |= {key: _bigint(value) for key, value in values.items() if isinstance(value, int)}
    return {"blob_id": blob_id, **values}


def _bigint(value: int | None) -> int | None:
    # Log times are unsigned 64 bit; one after the year 2262 fits no column and is no real recording's.
    return value if value is None or value <= _MAX_BIGINT else None


# -- recording verifications and damage -------------------------------------------------------------------------------


async def record_verified(db: Connection, md5s: Mapping[uuid.UUID, bytes]) -> None:
    """Record that the server has read blobs and confirmed their SHA-256, with the MD5 of each.

    A blob that was damaged is intact again.
    """
    repaired = await _lock_damaged(db, md5s)
    rows = unnest_rows([blob.c.id, blob.c.md5], [{"id": blob_id, "md5": md5} for blob_id, md5 in md5s.items()])
    values = {"state": BlobState.verified.value, "state_reason": None, "damaged_at": None, "md5": rows.c.md5}
    await db.execute(update(blob).where(blob.c.id == rows.c.id).values(**values, verified_at=func.now()))
    for blob_id, before in repaired.items():
        await _audit_files(db, blob_id, "file.recover", {"state": before}, {"state": BlobState.verified.value})
    await publish_file_changes(db, md5s)


async def record_small_blobs(
    db: Connection, summaries: Mapping[uuid.UUID, RecordingSummary], md5s: Mapping[uuid.UUID, bytes]
) -> None:
    """Record summaries and verifications of small blobs, and drop the jobs that were queued for them."""
    await record_summaries(db, summaries)
    await record_verified(db, md5s)
    await delete_waiting(db, Job.summarise_and_verify_blob, md5s)


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


# -- what follows from a change ---------------------------------------------------------------------------------------


async def _lock_missions_of(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    """Lock the missions of blobs; to be done before locking the blobs, as linking does."""
    await lock_missions(db, await _missions_of(db, blob_ids))


async def _derive_missions_of(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    """Queue the recordings of these blobs' missions to be derived again, and publish that their files changed."""
    for mission_id in await _missions_of(db, blob_ids):
        await derive_again(db, mission_id)
    await publish_file_changes(db, blob_ids)


async def publish_file_changes(db: Connection, blob_ids: Iterable[uuid.UUID]) -> None:
    """Publish that the files of these blobs changed."""
    files = select(file.c.id, file.c.mission_id).where(among(file.c.blob_id, blob_ids), file.c.deleted_at.is_(None))
    rows = await db.execute(files)
    await publish(db, [ChangeEvent("file", ChangeKind.changed, row.id, mission_id=row.mission_id) for row in rows])


async def _missions_of(db: Connection, blob_ids: Iterable[uuid.UUID]) -> list[uuid.UUID]:
    missions = select(file.c.mission_id).where(among(file.c.blob_id, blob_ids), file.c.deleted_at.is_(None))
    return sorted((await db.execute(missions.distinct())).scalars())
