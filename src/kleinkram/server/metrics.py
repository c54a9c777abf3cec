"""Metrics: of this process, and gauges of the whole site, which are read from the database when asked for."""

from collections import Counter as Tally
from collections.abc import Mapping, Sequence
from typing import Any

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Metric,
    ProcessCollector,
    disable_created_metrics,
    generate_latest,
)
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy import Row, func, select, text

import kleinkram
from kleinkram.contract.files import BlobState
from kleinkram.server.db import Database
from kleinkram.server.jobs.heartbeat import Workers, find_workers
from kleinkram.server.tables import blob, scrub, upload

disable_created_metrics()  # type: ignore[no-untyped-call]  # of the library's own; they double the number of series, and nobody reads them
REGISTRY = CollectorRegistry()
ProcessCollector(registry=REGISTRY)
Gauge("kleinkram_build_info", "The version of this process.", ["version"], registry=REGISTRY).labels(
    kleinkram.__version__
).set(1)
REQUESTS = Counter("kleinkram_requests", "Requests answered.", ["method", "route", "status"], registry=REGISTRY)
REQUEST_SECONDS = Histogram(
    "kleinkram_request_duration_seconds",
    "Time to answer a request.",
    ["method", "route"],
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10),
    registry=REGISTRY,
)
JOB_ATTEMPTS = Counter(
    "kleinkram_job_attempts",
    "Attempts at jobs: succeeded, failed (it is tried again), given_up or aborted.",
    ["task", "outcome"],
    registry=REGISTRY,
)
JOB_SECONDS = Histogram(
    "kleinkram_job_duration_seconds",
    "How long an attempt at a job took.",
    ["task"],
    buckets=(0.1, 0.5, 1, 5, 10, 60, 300, 1800, 7200),
    registry=REGISTRY,
)

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
_OLDEST_PROOF = select(func.coalesce(func.extract("epoch", func.now() - func.min(blob.c.proven_at)), 0)).where(
    blob.c.state == BlobState.proven.value, blob.c.doomed_at.is_(None)
)
_SCRUB = select(scrub).where(scrub.c.ended_at.is_not(None)).order_by(scrub.c.ended_at.desc()).limit(1)
_FINDINGS = ("lost", "corrupt", "found", "unknown")


async def look(database: Database) -> list[Metric]:
    """Return the gauges as the database has them, by some queries in one transaction."""
    async with database.begin() as db:
        blobs = (await db.execute(_BLOBS)).all()
        uploads = (await db.execute(_UPLOADS)).all()
        jobs = (await db.execute(_JOBS_SQL)).all()
        retrying = {row[0]: row[1] for row in await db.execute(_RETRYING_SQL)}
        workers = await find_workers(db)
        age_s = float((await db.execute(_QUEUE_AGE_SQL)).scalar_one())
        proof_s = float((await db.execute(_OLDEST_PROOF)).scalar_one())
        last = (await db.execute(_SCRUB)).one_or_none()
    states, sizes, contents = Tally[str](), Tally[str](), Tally[str]()
    for row in blobs:
        states[row.state] += row.number
        sizes[row.state] += int(row.size_bytes)
        contents[row.content] += row.number
    return [
        _gauge("kleinkram_blobs", "Blobs by state.", "state", states),
        _gauge("kleinkram_stored_bytes", "Bytes by state of their blob.", "state", sizes),
        _gauge("kleinkram_blob_content", "Blobs by what is known of their content.", "content", contents),
        _gauge("kleinkram_uploads", "Uploads by state.", "state", {row.state: row.number for row in uploads}),
        _jobs(jobs),
        _gauge("kleinkram_jobs_retrying", "Jobs that failed and wait for another attempt.", "task", retrying),
        GaugeMetricFamily(
            "kleinkram_queue_oldest_seconds", "Age of the oldest job that waits, or waits for a retry.", value=age_s
        ),
        *_workers(workers),
        GaugeMetricFamily("kleinkram_oldest_proof_seconds", "Since when the oldest proof is old.", value=proof_s),
        *_scrub(last),
    ]


def exposition(gauges: Sequence[Metric]) -> bytes:
    """Return this process's counters, and gauges that were looked up, in the Prometheus text format."""
    found = CollectorRegistry()
    found.register(_Found(gauges))
    return generate_latest(REGISTRY) + generate_latest(found)


class _Found(Collector):
    """Gauges of one moment, for a registry of that moment."""

    def __init__(self, gauges: Sequence[Metric]) -> None:
        self._gauges = gauges

    def collect(self) -> Sequence[Metric]:
        return self._gauges


def _workers(workers: Workers) -> list[Metric]:
    """Return how many worker processes are alive, and when one was last heard of (0: never)."""
    last_at = workers.last_seen_at.timestamp() if workers.last_seen_at else 0
    return [
        GaugeMetricFamily("kleinkram_workers", "Worker processes that are alive.", value=len(workers.seen_at)),
        GaugeMetricFamily(
            "kleinkram_worker_last_heartbeat_timestamp_seconds", "When a worker was last heard of.", value=last_at
        ),
    ]


def _gauge(name: str, text: str, label: str, values: Mapping[str, int]) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, text, labels=[label])
    for of, value in values.items():
        family.add_metric([of], value)
    return family


def _scrub(last: Row[Any] | None) -> list[Metric]:
    """Return what the last comparison of the store with the database found; nothing where there was none."""
    if last is None:
        return []
    at, found = last.ended_at.timestamp(), {name: getattr(last, name) for name in _FINDINGS}
    stopped = int(last.stopped is not None)
    return [
        GaugeMetricFamily("kleinkram_scrub_ended_timestamp_seconds", "When the last scrub ended.", value=at),
        GaugeMetricFamily("kleinkram_scrub_stopped", "Whether it stopped and marked nothing.", value=stopped),
        GaugeMetricFamily("kleinkram_scrub_compared", "Blobs that it compared.", value=last.compared),
        _gauge("kleinkram_scrub_findings", "What it found.", "finding", found),
    ]


def _jobs(rows: Sequence[Row[Any]]) -> GaugeMetricFamily:
    family = GaugeMetricFamily("kleinkram_jobs", "Jobs by task and status.", labels=["task", "status"])
    for task, status, count in rows:
        family.add_metric([task, status], count)
    return family
