"""What `/metrics` shows: counters of this process, and gauges read from the database when asked."""

from collections import Counter as Tally
from collections.abc import Mapping, Sequence
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Histogram, Metric, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy import Row, func, select, text

from kleinkram.contract.files import BlobState
from kleinkram.server.db import Database
from kleinkram.server.tables import blob, scrub, upload

REGISTRY = CollectorRegistry()
REQUESTS = Counter("kleinkram_requests", "Requests answered.", ["method", "route", "status"], registry=REGISTRY)
REQUEST_SECONDS = Histogram(
    "kleinkram_request_duration_seconds",
    "Time to answer a request.",
    ["method", "route"],
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10),
    registry=REGISTRY,
)

_BLOBS = select(
    blob.c.state, blob.c.content, func.count().label("number"), func.sum(blob.c.size_bytes).label("size_bytes")
).group_by(blob.c.state, blob.c.content)
_UPLOADS = select(upload.c.state, func.count().label("number")).group_by(upload.c.state)
_JOBS_SQL = text("SELECT task_name, status::text, count(*) FROM procrastinate_jobs GROUP BY 1, 2")
_QUEUE_AGE_SQL = text(
    "SELECT coalesce(extract(epoch FROM now() - min(e.at)), 0) FROM procrastinate_jobs j"
    " JOIN procrastinate_events e ON e.job_id = j.id AND e.type = 'deferred' WHERE j.status = 'todo'"
    " AND (j.scheduled_at IS NULL OR j.scheduled_at <= now())"
)
_OLDEST_PROOF = select(func.coalesce(func.extract("epoch", func.now() - func.min(blob.c.proven_at)), 0)).where(
    blob.c.state == BlobState.proven.value, blob.c.doomed_at.is_(None)
)
_SCRUB = select(scrub).where(scrub.c.ended_at.is_not(None)).order_by(scrub.c.ended_at.desc()).limit(1)
_FINDINGS = ("lost", "corrupt", "found", "unknown")


async def look(database: Database) -> list[Metric]:
    """Return the gauges as the database has them, by six queries in one transaction."""
    async with database.begin() as db:
        blobs = (await db.execute(_BLOBS)).all()
        uploads = (await db.execute(_UPLOADS)).all()
        jobs = (await db.execute(_JOBS_SQL)).all()
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
        _gauge("kleinkram_content", "Blobs by what is known of their content.", "content", contents),
        _gauge("kleinkram_uploads", "Uploads by state.", "state", {row.state: row.number for row in uploads}),
        _jobs(jobs),
        GaugeMetricFamily("kleinkram_queue_oldest_seconds", "Age of the oldest job that waits.", value=age_s),
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
