"""Garbage collection: finds blobs that nothing refers to, marks them, and later deletes their objects and rows.

A marked blob can never be linked again. A backup that copies objects pauses deletion by a lock in the database, which
ends with its process, its connection, or minutes of silence.
"""

import datetime
import time
import uuid
from collections.abc import Sequence
from typing import NamedTuple

from sqlalchemy import ColumnElement, delete, func, select, text, true, update

from kleinkram.server.blobs import queries
from kleinkram.server.db import Connection
from kleinkram.server.tables import blob, recording_preview

DELETION_LOCK = 0x6B6C_6261_636B
"""The advisory lock that pauses deletion; no other code locks this number in this database."""
# Source: PostgreSQL, "pg_locks": a bigint's upper half is classid, its lower half objid, and objsubid is 1.
_IS_LOCKED = text(
    "SELECT EXISTS (SELECT FROM pg_locks l JOIN pg_database d ON d.oid = l.database"
    " WHERE l.locktype = 'advisory' AND l.classid = :upper AND l.objid = :lower AND l.objsubid = 1 AND l.granted"
    " AND d.datname = current_database())"
)
# With more blobs than this, a round checks one share of them, and four hours of rounds check all. The number of shares
# is prime, so that rounds that are all late by the same time still reach every share.
_MAX_AT_ONCE, _SHARES, _ROUND_S = 50_000, 23, 600


class ObjectToDelete(NamedTuple):
    """A marked blob, the key of its object, and that of the preview of the recording, if it has one."""

    id: uuid.UUID
    key: str
    preview_key: str | None


async def is_deletion_paused(db: Connection) -> bool:
    """Return whether a backup needs all objects to stay, even those that nothing refers to."""
    halves = {"upper": DELETION_LOCK >> 32, "lower": DELETION_LOCK & 0xFFFF_FFFF}
    return bool((await db.execute(_IS_LOCKED, halves)).scalar_one())


async def mark_unreferenced(db: Connection, *, limit: int) -> int:
    """Mark blobs that nothing refers to; return how many.

    The candidates are locked first, then checked again: a file that was linked in between, under the lock that linking
    takes too, saves its blob.
    """
    is_garbage = ~queries.is_referenced()
    candidates = (
        select(blob.c.id)
        .where(blob.c.marked_for_deletion_at.is_(None), is_garbage, await is_in_share(db))
        .order_by(blob.c.id)
        .limit(limit)
        .with_for_update(skip_locked=True)
    )
    ids = (await db.execute(candidates)).scalars().all()
    if not ids:
        return 0
    mark = update(blob).where(blob.c.id.in_(ids), is_garbage).values(marked_for_deletion_at=func.now())
    return (await db.execute(mark)).rowcount


async def is_in_share(db: Connection) -> ColumnElement[bool]:
    """Return the condition for this round's share of the blobs; ids are random, so all shares are equally large."""
    others = select(blob.c.id).order_by(blob.c.id).offset(_MAX_AT_ONCE).limit(1)
    if (await db.execute(others)).first() is None:
        return true()
    share = _current_share()
    first, following = (2**128 * number // _SHARES for number in (share, share + 1))
    return blob.c.id.between(uuid.UUID(int=first), uuid.UUID(int=following - 1))


def _current_share() -> int:
    return int(time.time()) // _ROUND_S % _SHARES


async def objects_to_delete(db: Connection, *, store_id: str, grace_s: float, limit: int) -> Sequence[ObjectToDelete]:
    """Return this store's blobs that were marked longer ago than the grace period."""
    before = func.now() - datetime.timedelta(seconds=grace_s)
    # Checked once more although nothing can link to a marked blob: deletion cannot be undone.
    is_due = (blob.c.store_id == store_id) & (blob.c.marked_for_deletion_at < before) & ~queries.is_referenced()
    statement = (
        select(blob.c.id, blob.c.key, recording_preview.c.key)
        .outerjoin(recording_preview, recording_preview.c.blob_id == blob.c.id)
        .where(is_due)
        .order_by(blob.c.marked_for_deletion_at)
        .limit(limit)
    )
    return [ObjectToDelete._make(row) for row in await db.execute(statement)]


async def delete_row(db: Connection, blob_id: uuid.UUID) -> None:
    """Delete the row of a marked blob whose object is gone."""
    await db.execute(delete(blob).where(blob.c.id == blob_id, blob.c.marked_for_deletion_at.is_not(None)))
