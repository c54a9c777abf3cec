"""What `/metrics` shows: counters of this process, and gauges read from the database when asked."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from sqlalchemy import func, select, text

from kleinkram.server.db import Connection
from kleinkram.server.tables import blob, upload

REGISTRY = CollectorRegistry()
REQUESTS = Counter("kleinkram_requests", "Requests answered.", ["method", "route", "status"], registry=REGISTRY)
REQUEST_SECONDS = Histogram(
    "kleinkram_request_duration_seconds",
    "Time to answer a request.",
    ["method", "route"],
    buckets=(0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10),
    registry=REGISTRY,
)
_BLOBS = Gauge("kleinkram_blobs", "Blobs by state.", ["state"], registry=REGISTRY)
_BYTES = Gauge("kleinkram_stored_bytes", "Bytes by state of their blob.", ["state"], registry=REGISTRY)
_CONTENT = Gauge("kleinkram_content", "Blobs by what is known of their content.", ["content"], registry=REGISTRY)
_UPLOADS = Gauge("kleinkram_uploads", "Uploads by state.", ["state"], registry=REGISTRY)
_JOBS = Gauge("kleinkram_jobs", "Jobs by task and status.", ["task", "status"], registry=REGISTRY)
_QUEUE_AGE = Gauge("kleinkram_queue_oldest_seconds", "Age of the oldest job that waits.", registry=REGISTRY)

_JOBS_SQL = text("SELECT task_name, status::text, count(*) FROM procrastinate_jobs GROUP BY 1, 2")
_QUEUE_AGE_SQL = text(
    "SELECT coalesce(extract(epoch FROM now() - min(e.at)), 0) FROM procrastinate_jobs j"
    " JOIN procrastinate_events e ON e.job_id = j.id AND e.type = 'deferred' WHERE j.status = 'todo'"
    " AND (j.scheduled_at IS NULL OR j.scheduled_at <= now())"
)


async def exposition(db: Connection) -> bytes:
    """Return all measures in the Prometheus text format."""
    for gauge in (_BLOBS, _BYTES, _CONTENT, _UPLOADS, _JOBS):
        gauge.clear()
    by_state = select(blob.c.state, func.count(), func.sum(blob.c.size_bytes)).group_by(blob.c.state)
    for state, count, size_bytes in await db.execute(by_state):
        _BLOBS.labels(state).set(count)
        _BYTES.labels(state).set(int(size_bytes))
    for content, count in await db.execute(select(blob.c.content, func.count()).group_by(blob.c.content)):
        _CONTENT.labels(content).set(count)
    for state, count in await db.execute(select(upload.c.state, func.count()).group_by(upload.c.state)):
        _UPLOADS.labels(state).set(count)
    for task, status, count in await db.execute(_JOBS_SQL):
        _JOBS.labels(task, status).set(count)
    _QUEUE_AGE.set(float((await db.execute(_QUEUE_AGE_SQL)).scalar_one()))
    return generate_latest(REGISTRY)
