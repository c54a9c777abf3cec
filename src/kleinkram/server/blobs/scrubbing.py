"""A scrub: what the store lists, compared with what the database knows. Finds what vanished, or changed its size.

Reads no object and deletes nothing. Holds one page of the list and at most some thousand suspects, however many
objects there are. Never called inside a transaction.
"""

import asyncio
import datetime
import logging
import uuid
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.files import BlobState
from kleinkram.server.blobs import queries, scrubs, service
from kleinkram.server.blobs.scrubs import Tally
from kleinkram.server.context import AppContext

_log = logging.getLogger("kleinkram.blobs")
_BATCH = 1000
_AT_ONCE = 16
# More missing than these, or all there are: then it is rather the store that is another one.
_FEW_MISSING, _SHARE_MISSING = 10, 0.05
_MOST_SUSPECTS = 10_000
_OF_THE_PROBE = "probe/"
_DAMAGED = {BlobState.lost.value, BlobState.corrupt.value}


class Stopped(Exception):
    """A scrub would not go on, and marked nothing: its text says why."""


@dataclass
class _Walk:
    """What one scrub has seen so far. Suspects are blobs that the list does not show as they should be."""

    context: AppContext
    started_at: datetime.datetime
    believes: bool
    tally: Tally = field(default_factory=Tally)
    missing: int = 0
    suspects: list[Row[Any]] = field(default_factory=list)


async def scrub_store(context: AppContext, scrub_id: uuid.UUID) -> None:
    """Do a scrub from beginning to end, and keep what it found. One that has ended is left as it is.

    Raises:
        StoreUnavailable: the store did not answer, or not to the end; what was not compared yet was not judged.
    """
    async with context.database.begin() as db:
        row = await scrubs.start(db, scrub_id)
    if row is None or row.store_id != context.settings.store_id:
        return
    walk = _Walk(context, row.started_at, row.believes)
    stopped = None
    try:
        async for _ in _compare(walk):
            await _judge(walk) if walk.believes else _see_whether_it_is_ours(walk)
            async with context.database.begin() as db:
                await scrubs.note(db, scrub_id, walk.tally)
        if not walk.believes:
            _see_whether_it_is_ours(walk, at_end=True)
        await _judge(walk)
    except Stopped as reason:
        stopped = str(reason)
        _log.error("scrub stopped", extra={"fields": {"scrub_id": str(scrub_id), "reason": stopped}})
    async with context.database.begin() as db:
        await scrubs.end(db, scrub_id, walk.tally, stopped=stopped)
    _log.info("store scrubbed", extra={"fields": {"scrub_id": str(scrub_id), **vars(walk.tally)}})


async def _compare(walk: _Walk) -> AsyncIterator[None]:
    """Go through the list, and through the blobs that it must show; yield whenever some of them were compared."""
    after = ""
    async for listed in walk.context.storage.size_pages():
        if not listed:
            continue
        if min(listed) <= after:
            raise Stopped("The store does not list its objects by their keys, so they cannot be compared.")
        until = max(listed)
        async for _ in _compare_page(walk, listed, after, until):
            yield
        after = until
    async for _ in _compare_page(walk, {}, after, None):
        yield


async def _compare_page(walk: _Walk, listed: Mapping[str, int], after: str, until: str | None) -> AsyncIterator[None]:
    store_id, known = walk.context.settings.store_id, set[str]()
    while True:
        kept = queries.kept_between(store_id, after, until, since_before=walk.started_at, limit=_BATCH)
        async with walk.context.database.begin() as db:
            rows = (await db.execute(kept)).all()
        for row in rows:
            _look_at(walk, row, listed.get(row.key))
        known |= {row.key for row in rows if row.key in listed}
        yield
        if len(rows) < _BATCH:
            break
        after = rows[-1].key
    strange = [key for key in listed if key not in known and not key.startswith(_OF_THE_PROBE)]
    if strange:
        async with walk.context.database.begin() as db:
            walk.tally.unknown += (await db.execute(queries.unknown_among(store_id, strange))).scalar_one()


def _look_at(walk: _Walk, row: Row[Any], listed_bytes: int | None) -> None:
    if listed_bytes is None and row.state == BlobState.lost.value:
        return  # nothing new
    walk.tally.compared += 1
    walk.tally.compared_bytes += row.size_bytes
    if listed_bytes is None:
        walk.missing += 1
        walk.suspects.append(row)
    elif row.state in _DAMAGED or listed_bytes != row.size_bytes:
        walk.suspects.append(row)


def _see_whether_it_is_ours(walk: _Walk, *, at_end: bool = False) -> None:
    """See that what is missing is the exception.

    Raises:
        Stopped: it is not.
    """
    compared = walk.tally.compared
    too_many = walk.missing > max(_FEW_MISSING, _SHARE_MISSING * compared) or 0 < walk.missing == compared
    if len(walk.suspects) > _MOST_SUSPECTS or (at_end and too_many):
        settings = walk.context.settings
        raise Stopped(
            f"Of {compared} objects compared, {walk.missing} are not in the list of bucket {settings.s3_bucket!r}. "
            "It looks like another store, or like one that lists only a part, so nothing was marked. See that "
            "KLEINKRAM_S3_BUCKET and KLEINKRAM_S3_INTERNAL_URL name the right one. If they do, and the objects are "
            "gone, `klein admin scrub --believe` marks them as lost."
        )


async def _judge(walk: _Walk) -> None:
    """Ask the store for each suspect by itself, and keep what it says."""
    suspects, walk.suspects = walk.suspects, []
    for start in range(0, len(suspects), _AT_ONCE):
        some = suspects[start : start + _AT_ONCE]
        found = await asyncio.gather(*(walk.context.storage.find(row.key) for row in some))
        for row, stored in zip(some, found, strict=True):
            await _keep(walk, row, None if stored is None else stored.size_bytes)


async def _keep(walk: _Walk, row: Row[Any], stored_bytes: int | None) -> None:
    async with walk.context.database.begin() as db:
        if stored_bytes is None:
            reason = "the store no longer has the object"
            walk.tally.lost += await service.keep_damage(db, row.id, state=BlobState.lost, reason=reason)
        elif stored_bytes != row.size_bytes:
            reason = f"it has {stored_bytes} bytes, and came with {row.size_bytes}"
            walk.tally.corrupt += await service.keep_damage(db, row.id, state=BlobState.corrupt, reason=reason)
        elif row.state in _DAMAGED:
            # Its size is right; the verification compares its bytes.
            await service.verify_again(db, row.id)
            walk.tally.found += row.state == BlobState.lost.value
