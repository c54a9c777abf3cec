"""The port that Prometheus scrapes: a process's own metrics from every process, gauges of the whole site from one.

It is a port of its own, since a proxy before the API's port would publish whatever that serves. Who gives the site's
gauges is settled by an advisory lock in the database: the first process that is scraped takes it, and another one once
that ends or is no longer scraped. So sums over all processes are right, however many there are.
"""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import psycopg
from aiohttp import web
from prometheus_client import CONTENT_TYPE_LATEST, Metric
from psycopg.conninfo import make_conninfo
from sqlalchemy.exc import SQLAlchemyError

from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.server import metrics
from kleinkram.server.db import Database
from kleinkram.server.health.recent import Recent
from kleinkram.server.settings import Settings, plain_dsn

_log = logging.getLogger("kleinkram.metrics")
# Of one database, whose processes settle by it who reports.
_LOCK = 0x6B6C6D65
_HOLDS_S = 1.0
# Longer than any usual scrape interval.
_UNSCRAPED_S = 180.0
_CONNECTION: dict[str, str | int] = {
    "application_name": "kleinkram metrics",
    "connect_timeout": 5,
    "keepalives_idle": 15,
    "keepalives_interval": 5,
    "keepalives_count": 3,
}


class MetricsPortUnusable(Exception):
    """The port for metrics cannot be listened on. The text says which, and what to do."""


class _SiteGauges:
    """Gauges of the whole site, as long as this process is the one that reports them."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._dsn = make_conninfo(plain_dsn(settings.database_url), **_CONNECTION)
        self._recent = Recent(lambda: metrics.look(database), holds_s=_HOLDS_S)
        self._turn = asyncio.Lock()
        self._connection: psycopg.AsyncConnection[tuple[object, ...]] | None = None
        self._release: asyncio.TimerHandle | None = None
        self._releasing: asyncio.Task[None] | None = None

    async def look(self) -> list[Metric]:
        """Return the gauges; none where another process reports them, or the database does not give them."""
        async with self._turn:
            try:
                if not await self._is_reporter():
                    return []
                return await self._recent.get()
            except (psycopg.Error, DatabaseUnavailable, SQLAlchemyError) as error:  # away, or its schema is another
                _log.warning("no metrics of the site", extra={"fields": {"reason": type(error).__name__}})
                await self.close()
                return []

    async def close(self) -> None:
        """Leave it to another process."""
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
async def serve_metrics(settings: Settings, database: Database) -> AsyncIterator[int | None]:
    """Serve `/metrics` on a port of its own, where one is set; yields the port.

    Raises:
        MetricsPortUnusable: it is taken, or the address is none of this machine's.
    """
    if settings.metrics_port is None:
        yield None
        return
    gauges = _SiteGauges(settings, database)

    async def respond(_request: web.Request) -> web.Response:
        body = metrics.exposition(await gauges.look())
        return web.Response(body=body, headers={"Content-Type": CONTENT_TYPE_LATEST})

    app = web.Application()
    app.router.add_get("/metrics", respond)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=1)
    await runner.setup()
    try:
        try:
            await web.TCPSite(runner, settings.metrics_address, settings.metrics_port).start()
        except OSError as error:
            place = f"{settings.metrics_address}:{settings.metrics_port}"
            raise MetricsPortUnusable(
                f"Metrics cannot be served on {place} ({error.strerror or error}): give each process a free port by "
                "--metrics-port or KLEINKRAM_METRICS_PORT, and an address of this machine by KLEINKRAM_METRICS_ADDRESS."
            ) from None
        port: int = runner.addresses[0][1]
        _log.info("metrics", extra={"fields": {"address": settings.metrics_address, "port": port}})
        yield port
    finally:
        await runner.cleanup()
        await gauges.close()
