"""Reading what a run wrote: piece by piece, while it writes, and for good."""

import time
import uuid
from dataclasses import dataclass

from sqlalchemy import func, select

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.runs import LogChunkRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.events.hub import EventFilter, Hub
from kleinkram.server.runs import service
from kleinkram.server.tables import blob, log_chunk, run
from kleinkram.server.tables.run import ACTIVE

_PIECE_BYTES = 2**20
_LOOK_EVERY_S = 5.0
_LOG_NOUNS = frozenset({"run", "run_log"})


@dataclass(frozen=True)
class _Place:
    """Where the bytes of a log from some offset on are: in an object, from a byte of it on."""

    attempt: int
    is_over: bool
    size_bytes: int
    key: str | None = None
    begins: int = 0
    length: int = 0


async def read_log(
    context: AppContext, hub: Hub, actor: Actor, *, run_id: uuid.UUID, offset: int, wait_s: float
) -> LogChunkRead:
    """Return a piece of a log, and wait for one while the run lasts, where there is none yet.

    Raises:
        NotFound: the run is not there, or not for this actor.
        StoreUnavailable: the store does not answer.
        TooManyStreams: as many requests of this account wait as it gets.
    """
    if not wait_s:
        return await _read_now(context, actor, run_id, offset)
    until = time.monotonic() + wait_s
    with hub.long_poll(actor.person_id or actor.share_id, EventFilter(_LOG_NOUNS, run_id)) as listener:
        piece = await _read_now(context, actor, run_id, offset)
        while not (piece.text or piece.is_over or hub.is_closed) and (left_s := until - time.monotonic()) > 0:
            await hub.next_event(listener, timeout_s=min(left_s, _LOOK_EVERY_S))
            async with hub.rights_checks:  # however many wait, most connections are left to others
                piece = await _read_now(context, actor, run_id, offset)
        return piece


async def _read_now(context: AppContext, actor: Actor, run_id: uuid.UUID, offset: int) -> LogChunkRead:
    missing: str | None = None
    while True:
        async with context.database.begin() as db:
            place = await _find(db, actor, run_id, offset)
        piece = await _read_chunk(context, place, offset)
        if piece is not None:
            return piece
        # It may have been joined to the whole log just then: where it is now, the database says.
        if missing == place.key:
            raise StoreUnavailable(reason="it does not have this piece of the log")
        missing = place.key


async def _find(db: Connection, actor: Actor, run_id: uuid.UUID, offset: int) -> _Place:
    run_id = await service.results_of(db, actor, run_id)
    stmt = select(run.c.attempt, run.c.state, blob.c.key, blob.c.size_bytes)
    joined = stmt.outerjoin(blob, blob.c.id == run.c.log_blob_id).where(run.c.id == run_id)
    row = (await db.execute(joined)).one()
    is_over = row.state not in ACTIVE
    if row.key is not None:
        left = max(0, row.size_bytes - offset)
        return _Place(row.attempt, is_over, row.size_bytes, row.key, offset, min(left, _PIECE_BYTES))
    shown = (log_chunk.c.run_id == run_id) & (log_chunk.c.attempt == row.attempt) & log_chunk.c.kept_at.is_not(None)
    ends = log_chunk.c.offset_bytes + log_chunk.c.size_bytes
    size = (await db.execute(select(func.coalesce(func.max(ends), 0)).where(shown))).scalar_one()
    covering = select(log_chunk).where(shown, log_chunk.c.offset_bytes <= offset, ends > offset)
    segment = (await db.execute(covering.limit(1))).one_or_none()
    if segment is None:
        return _Place(row.attempt, is_over, size)
    begins = offset - segment.offset_bytes
    length = min(segment.size_bytes - begins, _PIECE_BYTES)
    return _Place(row.attempt, is_over, size, segment.key, begins, length)


async def _read_chunk(context: AppContext, place: _Place, offset: int) -> LogChunkRead | None:
    """Return what is at a place; None where the store has no such object."""
    data = b""
    if place.key is not None and place.length:
        try:
            data = await context.storage.read_range(place.key, offset=place.begins, size_bytes=place.length)
        except FileNotFoundError:
            return None
    is_last = offset + len(data) >= place.size_bytes
    if not (is_last and place.is_over):
        data = _whole_lines(data)
    return LogChunkRead(
        attempt=place.attempt,
        offset=offset,
        next_offset=offset + len(data),
        text=data.decode(errors="replace"),
        is_over=place.is_over and offset + len(data) >= place.size_bytes,
    )


def _whole_lines(data: bytes) -> bytes:
    """Return data up to its last whole line; of a line that is longer, up to its last whole character."""
    end = data.rfind(b"\n") + 1
    if end:
        return data[:end]
    # A character of UTF-8 has at most four bytes, all but its first of the form 10xxxxxx.
    for back in range(1, min(4, len(data)) + 1):
        first = data[-back]
        if first < 0x80:
            return data
        if first >= 0xC0:
            length = 2 if first < 0xE0 else 3 if first < 0xF0 else 4
            return data if length <= back else data[:-back]
    return data
