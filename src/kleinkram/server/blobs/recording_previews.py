"""Previews of recordings in the database: which are to be made, and their states.

A row names its object before it is written and until after it is deleted, so that no object is forgotten.
"""

import datetime
import uuid
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sqlalchemy import ColumnElement, exists, func, or_, select, text, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.files import BlobState, ContentState
from kleinkram.contract.recording_previews import RecordingPreviewState
from kleinkram.recordings.isolation import PreviewAnswer
from kleinkram.server.blobs import garbage_collection, queries, service
from kleinkram.server.db import Connection, fit_text
from kleinkram.server.jobs.queue import Job, Priority, enqueue, has_job, start_now, with_waiting_job
from kleinkram.server.tables import blob, file, recording_preview, topic

VERSION = 1
"""Of the contents of previews, `recordings.previews.PREVIEW_VERSION`; those of an earlier one are made again."""

READABLE = frozenset((ContentState.indexed, ContentState.recovered))
"""Contents of which a preview can be made."""

_COUNT_WAITING = text(
    "SELECT count(*) FROM procrastinate_jobs WHERE task_name = 'make_recording_preview' AND status = 'todo'"
)


# What is stored of a preview for lists and maps; it ends with the preview.
_FOR_LISTS: dict[str, object] = {"thumbnail": None, "is_position_known": False, "latitude": None, "longitude": None}
# Types of topics that may have a position, as in `recordings.previews`.
_POSITION_TYPES = r"(NavSatFix|GPSFix|LocationFix)$"


class RecordingPreviewRow(NamedTuple):
    """The preview of a blob. `temporary_failures`: in succession, of causes that may be gone the next time."""

    key: str | None
    state: str
    version: int
    size_bytes: int | None
    reason: str | None
    made_at: datetime.datetime
    temporary_failures: int


# -- queueing jobs ----------------------------------------------------------------------------------------------------


async def enqueue_new(db: Connection, blob_id: uuid.UUID) -> None:
    """Queue the preview of a recording that was read, unless it has one or is small."""
    due = select(blob.c.id).where(blob.c.id == blob_id, _is_due())
    ids = [str(one) for one in (await db.execute(due)).scalars()]
    await enqueue(db, Job.make_recording_preview, ids=ids, priority=Priority.normal)


async def enqueue_missing(db: Connection, *, store_id: str, limit: int) -> None:
    """Queue previews that are missing or of an earlier version, or failed once for a temporary cause a day ago.

    The newest recordings of this round's share of the blobs come first. At most `limit` wait at a time.
    """
    room = limit - (await db.execute(_COUNT_WAITING)).scalar_one()
    if room <= 0:
        return
    is_verified = blob.c.state == BlobState.verified.value
    in_share = await garbage_collection.is_in_share(db)
    due = select(blob.c.id).where(_is_due(), is_verified, blob.c.store_id == store_id, in_share)
    ids = [str(one) for one in (await db.execute(due.order_by(blob.c.created_at.desc()).limit(room))).scalars()]
    await enqueue(db, Job.make_recording_preview, ids=ids, priority=Priority.low)


def _is_due() -> ColumnElement[bool]:
    made = recording_preview.c.state != RecordingPreviewState.making.value
    failed = recording_preview.c.state == RecordingPreviewState.failed.value
    a_day_ago = recording_preview.c.made_at < func.now() - text("interval '1 day'")
    may_succeed = failed & (recording_preview.c.temporary_failures == 1) & a_day_ago
    is_ready = recording_preview.c.state == RecordingPreviewState.ready.value
    may_have_position = exists().where(topic.c.blob_id == blob.c.id, topic.c.message_type.regexp_match(_POSITION_TYPES))
    lacks_position = is_ready & ~recording_preview.c.is_position_known & may_have_position
    is_done = (recording_preview.c.version >= VERSION) & made & ~may_succeed & ~lacks_position
    is_deleted = recording_preview.c.state == RecordingPreviewState.deleted.value
    has_preview = exists().where(recording_preview.c.blob_id == blob.c.id, or_(is_done, is_deleted))
    return (
        blob.c.marked_for_deletion_at.is_(None)
        & blob.c.content.in_([state.value for state in READABLE])
        & ~queries.is_small()
        & exists().where(file.c.blob_id == blob.c.id)
        & ~has_preview
        & ~has_job(Job.make_recording_preview, blob.c.id)
    )


async def make_again(db: Connection, blob_id: uuid.UUID) -> None:
    """Queue the preview of a blob ahead of others, also if it was deleted or has failed.

    A job that runs satisfies the request only if its result is still to be recorded: later, it would be lost.
    """
    # Locked before jobs are looked at, so that one that runs cannot record its result in between.
    state = select(recording_preview.c.state).where(recording_preview.c.blob_id == blob_id).with_for_update()
    is_making = (await db.execute(state)).scalar_one_or_none() == RecordingPreviewState.making.value
    values = {"state": RecordingPreviewState.making.value, "version": VERSION, "reason": None}
    await _write(db, blob_id, {**values, "temporary_failures": 0})
    queued = select(blob.c.id).where(blob.c.id == blob_id, has_job(Job.make_recording_preview, blob.c.id))
    is_queued = is_making and (await db.execute(queued)).first() is not None
    if is_queued or await with_waiting_job(db, Job.make_recording_preview, [str(blob_id)]):
        await start_now(db, Job.make_recording_preview, blob_id)
        return
    await enqueue(db, Job.make_recording_preview, ids=[str(blob_id)], priority=Priority.high)


# -- states -----------------------------------------------------------------------------------------------------------


async def find_preview(db: Connection, blob_id: uuid.UUID) -> RecordingPreviewRow | None:
    """Return the preview of a blob; None if none was made."""
    columns = [recording_preview.c[name] for name in RecordingPreviewRow._fields]
    row = (await db.execute(select(*columns).where(recording_preview.c.blob_id == blob_id))).one_or_none()
    return None if row is None else RecordingPreviewRow._make(row)


async def record_begin(db: Connection, blob_id: uuid.UUID, *, key: str) -> bool:
    """Record that the preview of a blob is being made, and the key of its object; False if it was deleted."""
    values = {"state": RecordingPreviewState.making.value, "key": key, "version": VERSION}
    values |= {"size_bytes": None, **_FOR_LISTS}
    is_alive = recording_preview.c.state != RecordingPreviewState.deleted.value
    return await _write(db, blob_id, values, where=is_alive)


async def record_ready(db: Connection, blob_id: uuid.UUID, *, key: str, preview: PreviewAnswer) -> bool:
    """Record that the object is written, with what lists and maps show of it.

    Returns:
        False if another job has begun since, or the preview or blob is deleted.
    """
    values = {"state": RecordingPreviewState.ready.value, "size_bytes": len(preview.data)}
    values |= {"thumbnail": preview.thumbnail, "reason": None, "temporary_failures": 0}
    values |= {"is_position_known": True}
    if preview.position is not None:
        values |= {"latitude": preview.position.latitude, "longitude": preview.position.longitude}
    is_recorded = await _end(db, blob_id, key, values)
    if is_recorded:
        await service.publish_file_changes(db, [blob_id])
    return is_recorded


async def record_failure(db: Connection, blob_id: uuid.UUID, *, key: str, reason: str, temporary_failures: int) -> None:
    """Record why no preview could be made."""
    values = {"state": RecordingPreviewState.failed.value, "reason": fit_text(reason)}
    await _end(db, blob_id, key, {**values, "temporary_failures": temporary_failures})


async def _end(db: Connection, blob_id: uuid.UUID, key: str, values: dict[str, object]) -> bool:
    is_mine = (recording_preview.c.blob_id == blob_id) & (recording_preview.c.key == key)
    is_alive = exists().where(blob.c.id == blob_id, blob.c.marked_for_deletion_at.is_(None))
    is_making = recording_preview.c.state == RecordingPreviewState.making.value
    stmt = update(recording_preview).where(is_mine, is_alive, is_making).values(**values, made_at=func.now())
    return (await db.execute(stmt)).rowcount == 1


async def mark_deleted(db: Connection, blob_id: uuid.UUID) -> None:
    """Mark a preview as deleted: it is not made again by itself, and garbage collection deletes its object."""
    values = {"state": RecordingPreviewState.deleted.value, "version": VERSION, "size_bytes": None, "reason": None}
    await _write(db, blob_id, values | _FOR_LISTS)
    await service.publish_file_changes(db, [blob_id])


async def _write(
    db: Connection, blob_id: uuid.UUID, values: Mapping[str, object], *, where: ColumnElement[bool] | None = None
) -> bool:
    """Insert or, under a condition, update a row; return whether that was done."""
    store_id = select(blob.c.store_id).where(blob.c.id == blob_id).scalar_subquery()
    row = upsert(recording_preview).values(blob_id=blob_id, store_id=store_id, **values)
    row = row.on_conflict_do_update(index_elements=["blob_id"], set_=values, where=where)
    return (await db.execute(row.returning(recording_preview.c.blob_id))).first() is not None


# -- deletion of objects ----------------------------------------------------------------------------------------------


async def keys_to_delete(db: Connection, *, store_id: str, limit: int) -> Sequence[str]:
    """Return the keys of objects of previews that were deleted, or that failed.

    While a job runs, it may still write its object, and needs the key to record that.
    """
    ended = [RecordingPreviewState.deleted.value, RecordingPreviewState.failed.value]
    statement = select(recording_preview.c.key).where(
        recording_preview.c.store_id == store_id,
        recording_preview.c.state.in_(ended),
        recording_preview.c.key.is_not(None),
        ~has_job(Job.make_recording_preview, recording_preview.c.blob_id),
    )
    return (await db.execute(statement.limit(limit))).scalars().all()


async def record_deleted_object(db: Connection, key: str) -> None:
    """Record that an object is gone."""
    await db.execute(update(recording_preview).where(recording_preview.c.key == key).values(key=None))
