"""Reads the log of a run, in chunks, while it runs and afterwards."""

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
from kleinkram.server.tables import blob, log_chunk, run, run_log
from kleinkram.server.tables.runs import ACTIVE

_CHUNK_BYTES = 2**20
_CHECK_EVERY_S = 5.0
_LOG_RESOURCE_TYPES = frozenset({"run", "run_log"})


@dataclass(frozen=True)
class _StoredChunk:
    """Where the bytes of a log are at some offset: in an object, or, of a small log, here."""

    attempt: int
    is_over: bool
    size_bytes: int
    key: str | None = None
    begin: int = 0
    length: int = 0
    content: bytes | None = None


async def read_log(
    context: AppContext, hub: Hub, actor: Actor, *, run_id: uuid.UUID, offset: int, wait_s: float
) -> LogChunkRead:
    """Return a chunk of a log; while the run lasts, wait for one where there is none yet.

    Raises:
        NotFound: the run is not there, or not for this actor.
        StoreUnavailable: the store does not answer.
        TooManyStreams: too many requests of this account wait already.
    """
    if not wait_s:
        return await _read_now(context, actor, run_id, offset)
    until = time.monotonic() + wait_s
    with hub.long_poll(actor.person_id or actor.share_id, EventFilter(_LOG_RESOURCE_TYPES, run_id)) as subscription:
        chunk = await _read_now(context, actor, run_id, offset)
        while not (chunk.text or chunk.is_over or hub.is_closed) and (left_s := until - time.monotonic()) > 0:
            await hub.next_event(subscription, timeout_s=min(left_s, _CHECK_EVERY_S))
            async with hub.rights_checks:  # most database connections stay available to others
                chunk = await _read_now(context, actor, run_id, offset)
        return chunk


async def _read_now(context: AppContext, actor: Actor, run_id: uuid.UUID, offset: int) -> LogChunkRead:
    missing: str | None = None
    while True:
        async with context.database.begin() as db:
            stored = await _find(db, actor, run_id, offset)
        chunk = await _read_chunk(context, stored, offset)
        if chunk is not None:
            return chunk
        # The complete log may have replaced it: the database has the current object.
        if missing == stored.key:
            raise StoreUnavailable(reason="this chunk of the log is missing")
        missing = stored.key


async def _find(db: Connection, actor: Actor, run_id: uuid.UUID, offset: int) -> _StoredChunk:
    run_id = (await service.find_run(db, actor, run_id)).results_id
    stmt = select(run.c.attempt, run.c.state, blob.c.key, blob.c.size_bytes, run_log.c.content)
    joined = stmt.outerjoin(blob, blob.c.id == run.c.log_blob_id).outerjoin(run_log, run_log.c.run_id == run.c.id)
    row = (await db.execute(joined.where(run.c.id == run_id))).one()
    is_over = row.state not in ACTIVE
    if row.content is not None:
        return _StoredChunk(row.attempt, is_over, len(row.content), content=row.content[offset:])
    if row.key is not None:
        left = max(0, row.size_bytes - offset)
        return _StoredChunk(row.attempt, is_over, row.size_bytes, row.key, offset, min(left, _CHUNK_BYTES))
    shown = (
        (log_chunk.c.run_id == run_id) & (log_chunk.c.attempt == row.attempt) & log_chunk.c.confirmed_at.is_not(None)
    )
    ends = log_chunk.c.offset_bytes + log_chunk.c.size_bytes
    size = (await db.execute(select(func.coalesce(func.max(ends), 0)).where(shown))).scalar_one()
    covering = select(log_chunk).where(shown, log_chunk.c.offset_bytes <= offset, ends > offset)
    chunk_row = (await db.execute(covering.limit(1))).one_or_none()
    if chunk_row is None:
        return _StoredChunk(row.attempt, is_over, size)
    begin = offset - chunk_row.offset_bytes
    length = min(chunk_row.size_bytes - begin, _CHUNK_BYTES)
    return _StoredChunk(row.attempt, is_over, size, chunk_row.key, begin, length)


async def _read_chunk(context: AppContext, stored: _StoredChunk, offset: int) -> LogChunkRead | None:
    """Read a chunk; None where the store has no such object."""
    data = stored.content or b""
    if stored.key is not None and stored.length:
        try:
            data = await context.storage.read_range(stored.key, offset=stored.begin, size_bytes=stored.length)
        except FileNotFoundError:
            return None
    is_last = offset + len(data) >= stored.size_bytes
    if not (is_last and stored.is_over):
        data = _complete_lines(data)
    return LogChunkRead(
        attempt=stored.attempt,
        offset=offset,
        next_offset=offset + len(data),
        text=data.decode(errors="replace"),
        is_over=stored.is_over and offset + len(data) >= stored.size_bytes,
    )


def _complete_lines(data: bytes) -> bytes:
    """Return data up to its last complete line, or in a longer line, up to its last complete character."""
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
