"""The book of scrubs: which were asked for or are due, how far one is, and what the last one found."""

import datetime
import uuid
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import Row, delete, func, insert, select, update

from kleinkram.server.blobs import queries
from kleinkram.server.db import Connection
from kleinkram.server.jobs.queue import Job, Urgency, enqueue, has_job
from kleinkram.server.settings import Settings
from kleinkram.server.tables import scrub

# So many are remembered: three months of daily ones.
_REMEMBERED = 100


@dataclass
class Tally:
    """What a scrub counted: blobs compared and their bytes; lost, corrupt and found again; objects of nobody."""

    compared: int = 0
    compared_bytes: int = 0
    lost: int = 0
    corrupt: int = 0
    found: int = 0
    unknown: int = 0


async def ask_for_scrub(db: Connection, store_id: str, *, by_id: uuid.UUID, believes: bool) -> Row[Any]:
    """Return the scrub that is under way, or one that begins soon; one that believes takes over one that does not."""
    await _hold(db)
    last = await last_scrub(db, store_id)
    if last is None or last.ended_at is not None or (believes and not last.believes):
        await _begin(db, store_id, by_id=by_id, believes=believes, urgency=Urgency.soon)
        last = await last_scrub(db, store_id)
    if last is None:
        raise AssertionError("a scrub was begun and is not there")
    return last


async def begin_due_scrub(db: Connection, settings: Settings) -> None:
    """Begin a scrub where the last one began long enough ago, and take up one whose job was given up or forgotten."""
    await _hold(db)
    last = await last_scrub(db, settings.store_id)
    if last is not None and last.ended_at is None:
        waiting = select(scrub.c.id).where(scrub.c.id == last.id, ~has_job(Job.scrub, scrub.c.id))
        if (await db.execute(waiting)).first() is not None:
            await enqueue(db, Job.scrub, ids=[str(last.id)], urgency=Urgency.whenever)
        return
    every = datetime.timedelta(hours=settings.scrub_hours)
    if every and (last is None or last.now - last.created_at >= every):
        await _begin(db, settings.store_id, by_id=None, believes=False, urgency=Urgency.whenever)
        await _forget_old(db, settings.store_id)


async def last_scrub(db: Connection, store_id: str) -> Row[Any] | None:
    """Return the scrub of a store that began last, with `now`."""
    stmt = select(scrub, func.now().label("now")).where(scrub.c.store_id == store_id)
    return (await db.execute(stmt.order_by(scrub.c.created_at.desc(), scrub.c.id).limit(1))).one_or_none()


async def blobs_by_state(db: Connection) -> Sequence[Row[Any]]:
    """Return number and bytes of blobs by state; of the lost and corrupt, those that something still refers to."""
    return (await db.execute(queries.wanted_by_state())).all()


async def oldest_verification_at(db: Connection) -> datetime.datetime | None:
    """Return the oldest `verified_at` of all blobs."""
    found: datetime.datetime | None = (await db.execute(queries.oldest_verification())).scalar_one()
    return found


async def start(db: Connection, scrub_id: uuid.UUID) -> Row[Any] | None:
    """Note that a scrub starts now, from the beginning; None where it has ended, or another one took over."""
    mine = update(scrub).where(scrub.c.id == scrub_id, scrub.c.ended_at.is_(None))
    blank = asdict(Tally())
    row = (await db.execute(mine.values(started_at=func.now(), seen_at=func.now(), **blank).returning(scrub))).first()
    if row is None:
        return None
    last = await last_scrub(db, row.store_id)
    if last is not None and last.id != scrub_id:
        await end(db, scrub_id, Tally(), stopped="Another scrub was asked for meanwhile, and took its place.")
        return None
    return row


async def note(db: Connection, scrub_id: uuid.UUID, tally: Tally) -> None:
    """Note how far a scrub is."""
    await db.execute(update(scrub).where(scrub.c.id == scrub_id).values(seen_at=func.now(), **asdict(tally)))


async def end(db: Connection, scrub_id: uuid.UUID, tally: Tally, *, stopped: str | None = None) -> None:
    """Note that a scrub has ended; `stopped` says why before its end."""
    values = {"seen_at": func.now(), "ended_at": func.now(), "stopped": stopped, **asdict(tally)}
    await db.execute(update(scrub).where(scrub.c.id == scrub_id).values(**values))


async def _hold(db: Connection) -> None:
    # Of two who ask at once, the second finds what the first began.
    await db.execute(select(func.pg_advisory_xact_lock(0x7363727562)))


async def _begin(db: Connection, store_id: str, *, by_id: uuid.UUID | None, believes: bool, urgency: Urgency) -> None:
    # By the clock, not by the transaction's start, which may lie before that of the one that it comes after.
    values = {"created_at": func.clock_timestamp(), "asked_by_id": by_id, "believes": believes}
    made = insert(scrub).values(id=uuid.uuid4(), store_id=store_id, **values).returning(scrub.c.id)
    scrub_id = (await db.execute(made)).scalar_one()
    await enqueue(db, Job.scrub, ids=[str(scrub_id)], urgency=urgency)


async def _forget_old(db: Connection, store_id: str) -> None:
    last = select(scrub.c.id).where(scrub.c.store_id == store_id).order_by(scrub.c.created_at.desc())
    kept = last.limit(_REMEMBERED).scalar_subquery()
    await db.execute(delete(scrub).where(scrub.c.store_id == store_id, scrub.c.id.not_in(kept)))
