"""Serves Prometheus metrics: those of this process, and gauges of the database from one process at a time.

`/health/live` on the same port tells that the event loop runs: the only page of a worker that needs no database.

A separate port, because a proxy publishes everything on the API's port. An advisory lock in the database decides which
process reports the gauges: the first that is scraped, and another one once it ends or is no longer scraped.
"""

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager

import psycopg
from aiohttp import web
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Metric, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from psycopg.conninfo import make_conninfo
from sqlalchemy import func, select, text
from sqlalchemy.exc import SQLAlchemyError

from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.contract.files import BlobState
from kleinkram.server.db import Database
from kleinkram.server.health.readiness import CachedLookup, find_workers
from kleinkram.server.metrics import REGISTRY
from kleinkram.server.settings import Settings, plain_dsn
from kleinkram.server.tables import blob, scrub, upload

_log = logging.getLogger("kleinkram.metrics")
# An advisory lock of the database.
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
_BLOBS = select(
    blob.c.state, blob.c.content, func.count().label("number"), func.sum(blob.c.size_bytes).label("size_bytes")
).group_by(blob.c.state, blob.c.content)
_UPLOADS = select(upload.c.state, func.count().label("number")).group_by(upload.c.state)
_JOBS_SQL = text("SELECT task_name, status::text, count(*) FROM procrastinate_jobs GROUP BY 1, 2")
# Jobs that wait for another attempt count from when they were first deferred; those put off on purpose do not.
_QUEUE_AGE_SQL = text(
    "SELECT coalesce(extract(epoch FROM now() - min(e.at)), 0) FROM procrastinate_jobs j"
    " JOIN procrastinate_events e ON e.job_id = j.id AND e.type = 'deferred' WHERE j.status = 'todo'"
    " AND (j.attempts > 0 OR j.scheduled_at IS NULL OR j.scheduled_at <= now())"
)
_RETRYING_SQL = text(
    "SELECT task_name, count(*) FROM procrastinate_jobs WHERE status = 'todo' AND attempts > 0 GROUP BY 1"
)
_OLDEST_VERIFICATION = select(func.coalesce(func.extract("epoch", func.now() - func.min(blob.c.verified_at)), 0)).where(
    blob.c.state == BlobState.verified.value, blob.c.marked_for_deletion_at.is_(None)
)
_SCRUB = select(scrub).where(scrub.c.ended_at.is_not(None)).order_by(scrub.c.ended_at.desc()).limit(1)
_FINDINGS = ("lost", "corrupt", "recovered", "unknown")


class MetricsPortUnusable(Exception):
    """The port for metrics cannot be opened. The text has the port, and what to do."""


class _ServerGauges:
    """Gauges of the server, if this process is the one that reports them."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._dsn = make_conninfo(plain_dsn(settings.database_url), **_CONNECTION)
        self._recent = CachedLookup(lambda: _server_metrics(database), holds_s=_HOLDS_S)
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
                return await self._recent.get()
            except (psycopg.Error, DatabaseUnavailable, SQLAlchemyError) as error:  # away, or its schema is another
                _log.warning("no gauges of the server", extra={"fields": {"reason": type(error).__name__}})
                await self.close()
                return []

    async def close(self) -> None:
        """Release the lock."""
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
    """Serve `/metrics` and `/health/live` on a port of their own, if one is set; yields the port.

    Raises MetricsPortUnusable.
    """
    if settings.metrics_port is None:
        yield None
        return
    gauges = _ServerGauges(settings, database)

    async def respond(_request: web.Request) -> web.Response:
        body = exposition(await gauges.collect())
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


async def _server_metrics(database: Database) -> list[Metric]:
    """Read the gauges in one transaction."""
    async with database.begin() as db:
        blobs = (await db.execute(_BLOBS)).all()
        uploads = (await db.execute(_UPLOADS)).all()
        jobs = (await db.execute(_JOBS_SQL)).all()
        retrying = {row[0]: row[1] for row in await db.execute(_RETRYING_SQL)}
        workers = await find_workers(db)
        age_s = float((await db.execute(_QUEUE_AGE_SQL)).scalar_one())
        verification_age_s = float((await db.execute(_OLDEST_VERIFICATION)).scalar_one())
        last = (await db.execute(_SCRUB)).one_or_none()
    states, sizes, contents = Counter[str](), Counter[str](), Counter[str]()
    for row in blobs:
        states[row.state] += row.number
        sizes[row.state] += int(row.size_bytes)
        contents[row.content] += row.number
    job_counts = GaugeMetricFamily("kleinkram_jobs", "Jobs by task and status.", labels=["task", "status"])
    for task, status, count in jobs:
        job_counts.add_metric([task, status], count)
    last_seen_at_s = workers.last_seen_at.timestamp() if workers.last_seen_at else 0
    upload_states = {row.state: row.number for row in uploads}
    gauges: list[Metric] = [
        _by_label("kleinkram_blobs", "Blobs by state.", "state", states),
        _by_label("kleinkram_stored_bytes", "Bytes by state of their blob.", "state", sizes),
        _by_label("kleinkram_blob_content", "Blobs by what is known of their content.", "content", contents),
        _by_label("kleinkram_uploads", "Uploads by state.", "state", upload_states),
        job_counts,
        _by_label("kleinkram_jobs_retrying", "Jobs that failed and wait for another attempt.", "task", retrying),
        _gauge("kleinkram_queue_oldest_seconds", "Age of the oldest job that waits, or waits for a retry.", age_s),
        _gauge("kleinkram_workers", "Worker processes that are alive.", len(workers.seen_at)),
        _gauge("kleinkram_worker_last_heartbeat_timestamp_seconds", "Last heartbeat of a worker.", last_seen_at_s),
        _gauge("kleinkram_oldest_verification_seconds", "Seconds since the oldest verification.", verification_age_s),
    ]
    if last is not None:
        findings = {name: getattr(last, name) for name in _FINDINGS}
        is_stopped = int(last.aborted_reason is not None)
        gauges += [
            _gauge("kleinkram_scrub_ended_timestamp_seconds", "When the last scrub ended.", last.ended_at.timestamp()),
            _gauge("kleinkram_scrub_stopped", "Whether the last scrub stopped and marked nothing.", is_stopped),
            _gauge("kleinkram_scrub_compared", "Blobs that the last scrub compared.", last.compared),
            _by_label("kleinkram_scrub_findings", "Objects by result of the last scrub.", "finding", findings),
        ]
    return gauges


def _gauge(name: str, text: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, text, value=value)


def _by_label(name: str, text: str, label: str, values: Mapping[str, int]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, text, labels=[label])
    for label_value, value in values.items():
        family.add_metric([label_value], value)
    return family


def exposition(gauges: Sequence[Metric]) -> bytes:
    """Return this process's counters and the given gauges in the Prometheus text format."""
    server_registry = CollectorRegistry()
    server_registry.register(_GaugeCollector(gauges))
    return generate_latest(REGISTRY) + generate_latest(server_registry)


class _GaugeCollector(Collector):
    """Collector of given gauges."""

    def __init__(self, gauges: Sequence[Metric]) -> None:
        self._gauges = gauges

    def collect(self) -> Sequence[Metric]:
        return self._gauges
