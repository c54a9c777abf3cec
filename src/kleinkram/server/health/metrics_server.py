"""Serves Prometheus metrics: those of this process, and gauges of the installation from one process at a time.

`/health/live` on the same port tells that the event loop runs: the only page of a worker that needs no database.

A separate port, because a proxy publishes everything on the API's port. An advisory lock in the database decides which
process reports the gauges: the first that is scraped, and another one once it ends or is no longer scraped.
"""

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager

import psycopg
from aiohttp import web
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Metric, generate_latest
from prometheus_client.registry import Collector
from psycopg.conninfo import make_conninfo
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.pool import QueuePool

import kleinkram
from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.metric_definitions import MetricSource
from kleinkram.server import metrics
from kleinkram.server.db import Database
from kleinkram.server.health.instance_metrics import read_gauges, read_slow_gauges
from kleinkram.server.health.readiness import CachedLookup
from kleinkram.server.settings import Settings, plain_dsn

_log = logging.getLogger("kleinkram.metrics")
# An advisory lock of the database.
_LOCK = 0x6B6C6D65
_HOLDS_S = 1.0
_SLOW_HOLDS_S = 30.0
# Slow gauges are read for at most a twentieth of the time.
_SLOW_TIME_FACTOR = 20
# A scrape without the gauges is better than none: Prometheus waits for 10 s.
_TIMEOUT_S = 5.0
# Longer than any usual scrape interval.
_UNSCRAPED_S = 180.0
_CONNECTION: dict[str, str | int] = {
    "application_name": "kleinkram metrics",
    "connect_timeout": 5,
    "keepalives_idle": 15,
    "keepalives_interval": 5,
    "keepalives_count": 3,
}
# The database is away, busy, or its schema is another.
_DATABASE_ERRORS = (psycopg.Error, DatabaseUnavailable, SQLAlchemyError, asyncio.TimeoutError)


class MetricsPortUnusable(Exception):
    """The port for metrics cannot be opened. The text has the port, and what to do."""


class _SlowGauges:
    """Gauges that are too slow for a scrape: it gets the last ones, and they are read again in the background."""

    def __init__(self, look_up: Callable[[], Awaitable[list[Metric]]]) -> None:
        self._look_up = look_up
        self._gauges: list[Metric] = []
        self._due_at_s = float("-inf")
        self._reading: asyncio.Task[None] | None = None

    async def get(self) -> list[Metric]:
        """Return the last gauges; waits only for the first ones, and then for a limited time."""
        if self._reading is None and time.monotonic() >= self._due_at_s:
            self._reading = asyncio.create_task(self._read())
        if not self._gauges and self._reading is not None:
            await asyncio.wait({self._reading}, timeout=_TIMEOUT_S)
        return self._gauges

    def forget(self) -> None:
        """Drop the gauges, because they will be too old when this process reports again."""
        if self._reading is not None:
            self._reading.cancel()
        self._gauges, self._due_at_s = [], float("-inf")

    async def _read(self) -> None:
        started_s, gauges = time.monotonic(), list[Metric]()
        try:
            gauges = await self._look_up()
        except _DATABASE_ERRORS as error:
            _log.warning("no slow gauges", extra={"fields": {"reason": type(error).__name__}})
        finally:
            self._reading = None
        took_s = time.monotonic() - started_s
        # After an error soon again, unless the database spent long on it, up to its limit for a statement.
        shortest_s = _SLOW_HOLDS_S if gauges else 0.0
        self._gauges, self._due_at_s = gauges, time.monotonic() + max(shortest_s, _SLOW_TIME_FACTOR * took_s)


class _InstanceGauges:
    """Gauges of the installation, if this process is the one that reports them."""

    def __init__(self, settings: Settings, database: Database) -> None:
        async def look_up() -> list[Metric]:
            async with database.autocommit() as db:
                return await read_gauges(db)

        async def look_up_slowly() -> list[Metric]:
            async with database.autocommit() as db:
                return await read_slow_gauges(db, settings)

        self._dsn = make_conninfo(plain_dsn(settings.database_url), **_CONNECTION)
        self._recent = CachedLookup(look_up, holds_s=_HOLDS_S)
        self._slow = _SlowGauges(look_up_slowly)
        self._lock = asyncio.Lock()
        self._connection: psycopg.AsyncConnection[tuple[object, ...]] | None = None
        self._release: asyncio.TimerHandle | None = None
        self._releasing: asyncio.Task[None] | None = None

    async def collect(self) -> list[Metric]:
        """Return the gauges; none if another process reports them or the database is not available."""
        async with self._lock:
            try:
                if not await self._is_reporter():
                    return []
                return [*await asyncio.wait_for(self._recent.get(), _TIMEOUT_S), *await self._slow.get()]
            except _DATABASE_ERRORS as error:
                _log.warning("no gauges of the installation", extra={"fields": {"reason": type(error).__name__}})
                await self.close()
                return []

    async def close(self) -> None:
        """Release the lock."""
        self._slow.forget()
        if self._release is not None:
            self._release.cancel()
        connection, self._connection = self._connection, None
        if connection is not None:
            await connection.close()

    async def _is_reporter(self) -> bool:
        if self._connection is None:
            connection = await psycopg.AsyncConnection.connect(self._dsn, autocommit=True)
            taken = await (await connection.execute("SELECT pg_try_advisory_lock(%s)", [_LOCK])).fetchone()
            if taken is None or not taken[0]:
                await connection.close()
                return False
            self._connection = connection
        else:
            await self._connection.execute("SELECT 1")  # the lock goes with the connection
        if self._release is not None:
            self._release.cancel()
        self._release = asyncio.get_running_loop().call_later(_UNSCRAPED_S, self._close_unscraped)
        return True

    def _close_unscraped(self) -> None:
        self._releasing = asyncio.create_task(self.close())


@asynccontextmanager
async def serve_metrics(settings: Settings, database: Database, role: MetricSource) -> AsyncIterator[int | None]:
    """Serve `/metrics` and `/health/live` of an `api` or `worker` on a port of its own, if set; yields the port.

    Raises MetricsPortUnusable.
    """
    if settings.metrics_port is None:
        yield None
        return
    metrics.BUILD_INFO.labels(kleinkram.__version__, role.name).set(1)
    gauges = _InstanceGauges(settings, database)

    async def respond(_request: web.Request) -> web.Response:
        _measure_pool(database)
        body = _exposition(role, await gauges.collect())
        return web.Response(body=body, headers={"Content-Type": CONTENT_TYPE_LATEST})

    async def live(_request: web.Request) -> web.Response:
        return web.Response(text="live\n")

    app = web.Application()
    app.router.add_get("/metrics", respond)
    app.router.add_get("/health/live", live)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=1)
    await runner.setup()
    try:
        try:
            await web.TCPSite(runner, settings.metrics_address, settings.metrics_port).start()
        except OSError as error:
            address = f"{settings.metrics_address}:{settings.metrics_port}"
            raise MetricsPortUnusable(
                f"Metrics cannot be served on {address} ({error.strerror or error}): give each process a free port by "
                "--metrics-port or KLEINKRAM_METRICS_PORT, and an address of this machine by KLEINKRAM_METRICS_ADDRESS."
            ) from None
        port: int = runner.addresses[0][1]
        _log.info("metrics", extra={"fields": {"address": settings.metrics_address, "port": port}})
        yield port
    finally:
        await runner.cleanup()
        await gauges.close()


def _measure_pool(database: Database) -> None:
    pool = database.engine.pool
    if isinstance(pool, QueuePool):
        metrics.DATABASE_CONNECTIONS.labels("in_use").set(pool.checkedout())
        metrics.DATABASE_CONNECTIONS.labels("idle").set(pool.checkedin())
        metrics.DATABASE_CONNECTIONS_MAX.set(pool.size())


def _exposition(role: MetricSource, gauges: Sequence[Metric]) -> bytes:
    """Return this process's metrics and the given gauges in the Prometheus text format."""
    instance = CollectorRegistry()
    instance.register(_GaugeCollector(gauges))
    own = [metrics.REGISTRIES[source] for source in (MetricSource.process, MetricSource.server, role)]
    return b"".join(generate_latest(registry) for registry in [*own, instance])


class _GaugeCollector(Collector):
    """Collector of given gauges."""

    def __init__(self, gauges: Sequence[Metric]) -> None:
        self._gauges = gauges

    def collect(self) -> Sequence[Metric]:
        return self._gauges
