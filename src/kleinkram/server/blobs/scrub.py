"""Scrub: compares the store's listing with the database to find objects that are missing or have another size.

Reads no object and deletes nothing. Memory holds one page of the listing and at most 10,000 suspects, whatever the
number of objects. Never runs inside a transaction.
"""

import asyncio
import datetime
import logging
import uuid
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

from sqlalchemy import delete, func, insert, select, update

from kleinkram.contract.files import BlobState
from kleinkram.server.blobs import queries, service
from kleinkram.server.blobs.queries import ExpectedBlob
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.jobs.queue import Job, Priority, enqueue, has_job
from kleinkram.server.settings import Settings
from kleinkram.server.tables import blob, scrub

_log = logging.getLogger("kleinkram.blobs")
_BATCH = 1000
_CONCURRENT_REQUESTS = 16
# If more objects than these are missing, or all, the bucket is probably the wrong one.
_MAX_MISSING, _MAX_MISSING_SHARE = 10, 0.05
_MAX_SUSPECTS = 10_000
_PROBE_PREFIX = "probe/"
_DAMAGED = {BlobState.lost.value, BlobState.corrupt.value}
_HISTORY = 100  # three months of daily scrubs
_ADVISORY_LOCK = 0x7363727562


class ScrubAborted(Exception):
    """A scrub was aborted and marked nothing; the message is the reason."""


@dataclass
class ScrubCounts:
    """Blobs compared and their bytes; lost, corrupt and recovered; objects without a row."""

    compared: int = 0
    compared_bytes: int = 0
    lost: int = 0
    corrupt: int = 0
    recovered: int = 0
    unknown: int = 0


class ScrubRow(NamedTuple):
    """A scrub as the database has it. `now` is the database's time."""

    id: uuid.UUID
    store_id: str
    created_at: datetime.datetime
    started_at: datetime.datetime | None
    ended_at: datetime.datetime | None
    seen_at: datetime.datetime | None
    accept_losses: bool
    requested_by_id: uuid.UUID | None
    aborted_reason: str | None
    compared: int
    compared_bytes: int
    lost: int
    corrupt: int
    recovered: int
    unknown: int
    now: datetime.datetime


class StateCount(NamedTuple):
    """Number and size of the blobs in a state."""

    state: str
    number: int
    size_bytes: int


# -- requests and results in the database -----------------------------------------------------------------------------


async def request_scrub(db: Connection, store_id: str, *, by_id: uuid.UUID, accept_losses: bool) -> ScrubRow:
    """Return the scrub that is running or queued, or a new one; one that `accept_losses` replaces one that does not."""
    await _lock(db)
    last = await last_scrub(db, store_id)
    if last is None or last.ended_at is not None or (accept_losses and not last.accept_losses):
        await _queue(db, store_id, by_id=by_id, accept_losses=accept_losses, priority=Priority.high)
        last = await last_scrub(db, store_id)
    if last is None:
        raise AssertionError("a scrub was inserted and is missing")
    return last


async def begin_due_scrub(db: Connection, settings: Settings) -> None:
    """Queue a scrub if the last one began long enough ago; queue one again whose job gave up."""
    await _lock(db)
    last = await last_scrub(db, settings.store_id)
    if last is not None and last.ended_at is None:
        forgotten = select(scrub.c.id).where(scrub.c.id == last.id, ~has_job(Job.scrub, scrub.c.id))
        if (await db.execute(forgotten)).first() is not None:
            await enqueue(db, Job.scrub, ids=[str(last.id)], priority=Priority.normal)
        return
    interval = datetime.timedelta(hours=settings.scrub_hours)
    if interval and (last is None or last.now - last.created_at >= interval):
        await _queue(db, settings.store_id, by_id=None, accept_losses=False, priority=Priority.normal)
        await _delete_old(db, settings.store_id)


async def last_scrub(db: Connection, store_id: str) -> ScrubRow | None:
    """Return the scrub of a store that began last."""
    columns = (*(scrub.c[name] for name in ScrubRow._fields[:-1]), func.now().label("now"))
    newest = select(*columns).where(scrub.c.store_id == store_id).order_by(scrub.c.created_at.desc(), scrub.c.id)
    row = (await db.execute(newest.limit(1))).one_or_none()
    return None if row is None else ScrubRow._make(row)


async def blobs_by_state(db: Connection) -> Sequence[StateCount]:
    """Return number and bytes of blobs by state; of damaged blobs, only those that something still refers to."""
    total = func.coalesce(func.sum(blob.c.size_bytes), 0).label("size_bytes")
    is_intact = blob.c.state.in_((BlobState.stored.value, BlobState.verified.value))
    counts = (
        select(blob.c.state, func.count().label("number"), total)
        .where(blob.c.marked_for_deletion_at.is_(None), is_intact | queries.is_referenced())
        .group_by(blob.c.state)
        .order_by(blob.c.state)
    )
    rows = await db.execute(counts)
    return [StateCount(row.state, row.number, int(row.size_bytes)) for row in rows]


async def oldest_verification(db: Connection) -> datetime.datetime | None:
    """Return the oldest `verified_at` of all blobs."""
    is_verified = (blob.c.state == BlobState.verified.value) & blob.c.marked_for_deletion_at.is_(None)
    oldest: datetime.datetime | None = await db.scalar(select(func.min(blob.c.verified_at)).where(is_verified))
    return oldest


async def start(db: Connection, scrub_id: uuid.UUID) -> datetime.datetime | None:
    """Start a scrub from the beginning and return when; None if it has ended, or another one has replaced it."""
    mine = update(scrub).where(scrub.c.id == scrub_id, scrub.c.ended_at.is_(None))
    values = {"started_at": func.now(), "seen_at": func.now(), **asdict(ScrubCounts())}
    row = (await db.execute(mine.values(**values).returning(scrub.c.store_id, scrub.c.started_at))).first()
    if row is None:
        return None
    last = await last_scrub(db, row.store_id)
    if last is not None and last.id != scrub_id:
        await end(db, scrub_id, ScrubCounts(), aborted_reason="A newer scrub request replaced this one.")
        return None
    started_at: datetime.datetime = row.started_at
    return started_at


async def record_progress(db: Connection, scrub_id: uuid.UUID, counts: ScrubCounts) -> None:
    """Record the counts of a scrub that continues."""
    await db.execute(update(scrub).where(scrub.c.id == scrub_id).values(seen_at=func.now(), **asdict(counts)))


async def end(db: Connection, scrub_id: uuid.UUID, counts: ScrubCounts, *, aborted_reason: str | None = None) -> None:
    """Record the end of a scrub; `aborted_reason`: why it did not finish."""
    values = {"seen_at": func.now(), "ended_at": func.now(), "aborted_reason": aborted_reason, **asdict(counts)}
    await db.execute(update(scrub).where(scrub.c.id == scrub_id).values(**values))


async def _lock(db: Connection) -> None:
    # Of two requests at the same time, the second finds what the first inserted.
    await db.execute(select(func.pg_advisory_xact_lock(_ADVISORY_LOCK)))


async def _queue(
    db: Connection, store_id: str, *, by_id: uuid.UUID | None, accept_losses: bool, priority: Priority
) -> None:
    # The clock and not the transaction's start, which may be before that of the previous scrub.
    values = {"created_at": func.clock_timestamp(), "requested_by_id": by_id, "accept_losses": accept_losses}
    scrub_id = uuid.uuid4()
    await db.execute(insert(scrub).values(id=scrub_id, store_id=store_id, **values))
    await enqueue(db, Job.scrub, ids=[str(scrub_id)], priority=priority)


async def _delete_old(db: Connection, store_id: str) -> None:
    newest = select(scrub.c.id).where(scrub.c.store_id == store_id).order_by(scrub.c.created_at.desc())
    recent = newest.limit(_HISTORY).scalar_subquery()
    await db.execute(delete(scrub).where(scrub.c.store_id == store_id, scrub.c.id.not_in(recent)))


# -- the comparison ---------------------------------------------------------------------------------------------------


@dataclass
class _Comparison:
    """The state of one scrub. Suspects are blobs that the listing lacks or shows with another size."""

    context: AppContext
    started_at: datetime.datetime
    accept_losses: bool
    counts: ScrubCounts = field(default_factory=ScrubCounts)
    missing: int = 0
    suspects: list[ExpectedBlob] = field(default_factory=list)


async def scrub_store(context: AppContext, scrub_id: uuid.UUID) -> None:
    """Run a scrub from the beginning and record the result; does nothing if it has ended.

    Raises:
        StoreUnavailable: the store stopped answering; objects that were not compared keep their state.
    """
    async with context.database.begin() as db:
        last = await last_scrub(db, context.settings.store_id)
        started_at = await start(db, scrub_id)
    if started_at is None or last is None or last.id != scrub_id:
        return
    comparison = _Comparison(context, started_at, last.accept_losses)
    aborted_reason = None
    try:
        async for _ in _compare(comparison):
            if comparison.accept_losses:
                await _check_suspects(comparison)
            else:
                _check_plausible(comparison)
            async with context.database.begin() as db:
                await record_progress(db, scrub_id, comparison.counts)
        if not comparison.accept_losses:
            _check_plausible(comparison, at_end=True)
        await _check_suspects(comparison)
    except ScrubAborted as error:
        aborted_reason = str(error)
        _log.error("scrub aborted", extra={"fields": {"scrub_id": str(scrub_id), "reason": aborted_reason}})
    async with context.database.begin() as db:
        await end(db, scrub_id, comparison.counts, aborted_reason=aborted_reason)
    _log.info("store scrubbed", extra={"fields": {"scrub_id": str(scrub_id), **vars(comparison.counts)}})


async def _compare(comparison: _Comparison) -> AsyncIterator[None]:
    """Compare the listing with the expected blobs, page by page; yield after each batch."""
    after = ""
    async for listed in comparison.context.storage.size_pages():
        if not listed:
            continue
        if min(listed) <= after:
            raise ScrubAborted("The store does not list its objects by their keys, so they cannot be compared.")
        until = max(listed)
        async for _ in _compare_page(comparison, listed, after, until):
            yield
        after = until
    async for _ in _compare_page(comparison, {}, after, None):
        yield


async def _compare_page(
    comparison: _Comparison, listed: Mapping[str, int], after: str, until: str | None
) -> AsyncIterator[None]:
    store_id, known_keys = comparison.context.settings.store_id, set[str]()
    while True:
        statement = queries.expected_between(store_id, after, until, since_before=comparison.started_at, limit=_BATCH)
        async with comparison.context.database.begin() as db:
            expected = [ExpectedBlob._make(row) for row in await db.execute(statement)]
        for row in expected:
            _compare_blob(comparison, row, listed.get(row.key))
        known_keys |= {row.key for row in expected if row.key in listed}
        yield
        if len(expected) < _BATCH:
            break
        after = expected[-1].key
    unexpected = [key for key in listed if key not in known_keys and not key.startswith(_PROBE_PREFIX)]
    if unexpected:
        async with comparison.context.database.begin() as db:
            unknown = (await db.execute(queries.unknown_among(store_id, unexpected))).scalar_one()
        comparison.counts.unknown += unknown


def _compare_blob(comparison: _Comparison, row: ExpectedBlob, listed_bytes: int | None) -> None:
    if listed_bytes is None and row.state == BlobState.lost.value:
        return  # recorded already
    comparison.counts.compared += 1
    comparison.counts.compared_bytes += row.size_bytes
    if listed_bytes is None:
        comparison.missing += 1
        comparison.suspects.append(row)
    elif row.state in _DAMAGED or listed_bytes != row.size_bytes:
        comparison.suspects.append(row)


def _check_plausible(comparison: _Comparison, *, at_end: bool = False) -> None:
    """Raise ScrubAborted if so many objects are missing that the bucket is probably the wrong one."""
    compared, missing = comparison.counts.compared, comparison.missing
    too_many = missing > max(_MAX_MISSING, _MAX_MISSING_SHARE * compared) or 0 < missing == compared
    if len(comparison.suspects) > _MAX_SUSPECTS or (at_end and too_many):
        settings = comparison.context.settings
        raise ScrubAborted(
            f"Of {compared} objects compared, {missing} are not in the list of bucket {settings.s3_bucket!r}. "
            "This may be another store, or one that lists only a part, so nothing was marked. Check that "
            "KLEINKRAM_S3_BUCKET and KLEINKRAM_S3_INTERNAL_URL name the right one. If they do, and the objects are "
            "gone, `klein admin scrub --accept-losses` marks them as lost."
        )


async def _check_suspects(comparison: _Comparison) -> None:
    """Request each suspect from the store, and record whether it is missing or has another size."""
    suspects, comparison.suspects = comparison.suspects, []
    for first in range(0, len(suspects), _CONCURRENT_REQUESTS):
        batch = suspects[first : first + _CONCURRENT_REQUESTS]
        objects = await asyncio.gather(*(comparison.context.storage.find(row.key) for row in batch))
        for row, stored in zip(batch, objects, strict=True):
            await _record(comparison, row, None if stored is None else stored.size_bytes)


async def _record(comparison: _Comparison, row: ExpectedBlob, stored_bytes: int | None) -> None:
    counts = comparison.counts
    async with comparison.context.database.begin() as db:
        if stored_bytes is None:
            reason = "the store no longer has the object"
            counts.lost += await service.record_damage(db, row.id, state=BlobState.lost, reason=reason)
        elif stored_bytes != row.size_bytes:
            reason = f"it has {stored_bytes} bytes instead of {row.size_bytes}"
            counts.corrupt += await service.record_damage(db, row.id, state=BlobState.corrupt, reason=reason)
        elif row.state in _DAMAGED:
            # Only its size is known to be right: the verification compares its bytes.
            await service.verify_again(db, row.id)
            counts.recovered += row.state == BlobState.lost.value
