"""Readiness: whether this process can serve, and which workers are alive by their heartbeats."""

import asyncio
import datetime
import logging
import os
import socket
import time
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Generic, TypeVar

from sqlalchemy import delete, func, select
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import SQLAlchemyError

import kleinkram
from kleinkram.contract.errors import DatabaseUnavailable, StoreUnavailable
from kleinkram.diagnostics import Diagnostic, find_problems, ok, problem, warning
from kleinkram.server.background import cancel_and_wait
from kleinkram.server.db import Connection, Database
from kleinkram.server.migrations import schema_problem
from kleinkram.server.s3.storage import Storage
from kleinkram.server.tables import worker_process

T = TypeVar("T")
_LOOKUP_TIME_FACTOR = 10


class CachedLookup(Generic[T]):
    """The last result of a lookup and when it expires. Failed lookups are not cached."""

    def __init__(self, look_up: Callable[[], Awaitable[T]], *, holds_s: float) -> None:
        self._look_up = look_up
        self._lifetime_s = holds_s
        self._lock = asyncio.Lock()
        self._cached: tuple[float, T] | None = None

    async def get(self) -> T:
        """Return a value that has not expired; concurrent callers share one lookup."""
        async with self._lock:
            if self._cached is None or time.monotonic() > self._cached[0]:
                started = time.monotonic()
                value = await self._look_up()
                took_s = time.monotonic() - started
                self._cached = (time.monotonic() + max(self._lifetime_s, _LOOKUP_TIME_FACTOR * took_s), value)
            return self._cached[1]


_log = logging.getLogger("kleinkram.worker")
_INTERVAL_S = 5.0
# A worker without a heartbeat for this long counts as ended.
ALIVE_WITHIN = datetime.timedelta(seconds=30)
_RETENTION = datetime.timedelta(days=30)
_SECONDS_A_MINUTE = 60


@dataclass(frozen=True)
class Workers:
    """The last heartbeats of living workers, latest first, and of any worker; by the database's clock."""

    seen_at: list[datetime.datetime]
    last_seen_at: datetime.datetime | None
    now: datetime.datetime


async def find_workers(db: Connection) -> Workers:
    """Return the living worker processes."""
    process = worker_process.c
    stmt = select(func.now().label("now"), func.max(process.seen_at).label("last_seen_at"))
    whole = (await db.execute(stmt)).one()
    alive = process.ended_at.is_(None) & (process.seen_at > func.now() - ALIVE_WITHIN)
    rows = await db.execute(select(process.seen_at).where(alive).order_by(process.seen_at.desc()))
    return Workers(list(rows.scalars()), whole.last_seen_at, whole.now)


@asynccontextmanager
async def heartbeat(database: Database) -> AsyncIterator[None]:
    """Write a heartbeat every 5 s, and at the end that this process has ended."""
    worker_id = uuid.uuid4()
    task = asyncio.create_task(_send_heartbeats(database, worker_id))
    try:
        yield
    finally:
        await cancel_and_wait(task)
        with suppress(DatabaseUnavailable, SQLAlchemyError):
            async with database.begin() as db:
                await db.execute(
                    worker_process.update().where(worker_process.c.id == worker_id).values(ended_at=func.now())
                )


async def _send_heartbeats(database: Database, worker_id: uuid.UUID) -> None:
    process = {"host": socket.gethostname(), "pid": os.getpid(), "version": kleinkram.__version__}
    heartbeat_stmt = upsert(worker_process).values(id=worker_id, **process)
    heartbeat_stmt = heartbeat_stmt.on_conflict_do_update(index_elements=["id"], set_={"seen_at": func.now()})
    old = delete(worker_process).where(worker_process.c.seen_at < func.now() - _RETENTION)
    while True:
        try:
            async with database.begin() as db:
                await db.execute(heartbeat_stmt)
                await db.execute(old)
        except (DatabaseUnavailable, SQLAlchemyError) as error:  # away, or its schema is older than this program
            _log.warning("heartbeat not written", extra={"fields": {"reason": str(error).partition("\n")[0]}})
        await asyncio.sleep(_INTERVAL_S)


_STORE_TIMEOUT_S = 2


async def check_service(database: Database, storage: Storage) -> list[Diagnostic]:
    """Check what this process needs to serve; releases its connection before it asks the store.

    An API process without workers only gets a warning: otherwise a load balancer would drop all of them.
    """
    try:
        async with database.begin() as db:
            results = await check_schema(db)
    except DatabaseUnavailable as error:
        return [problem("database", str(error))]
    if not find_problems(results):
        try:
            await asyncio.wait_for(storage.check(), _STORE_TIMEOUT_S)
        except StoreUnavailable as error:
            results.append(problem("store", str(error)))
        except asyncio.TimeoutError:
            message = f"The object store did not answer within {_STORE_TIMEOUT_S} seconds."
            results.append(problem("store", message))
    return results


async def check_schema(db: Connection) -> list[Diagnostic]:
    """Check that this program can use the database's schema, and that workers are alive."""
    reason = await schema_problem(db)
    if reason is not None:
        return [problem("schema", f"{reason[0].upper()}{reason[1:]}.")]
    workers = await find_workers(db)
    if workers.seen_at:
        return [ok("schema", "This program works on it."), ok("workers", f"{len(workers.seen_at)} alive.")]
    message = "No worker process has ever run"
    if workers.last_seen_at is not None:
        silent_s = (workers.now - workers.last_seen_at).total_seconds()
        message = f"No worker process has run for {max(1, round(silent_s / _SECONDS_A_MINUTE))} min"
    message += ": new files are not read or verified."
    remedy = "Start `python -m kleinkram.server worker`."
    return [ok("schema", "This program works on it."), warning("workers", message, remedy)]
