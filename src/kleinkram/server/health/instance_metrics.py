"""Gauges of the whole installation, read from the database.

Those in `read_gauges` take milliseconds. Those in `read_slow_gauges` read every blob or file.
"""

import datetime
import shutil
import uuid
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from prometheus_client import Metric
from prometheus_client.core import GaugeMetricFamily
from sqlalchemy import func, select, text

from kleinkram import metric_definitions as definitions
from kleinkram.contract.files import BlobState
from kleinkram.contract.runners import LEASE_S
from kleinkram.metric_definitions import MetricDefinition
from kleinkram.server.db import Connection
from kleinkram.server.health.readiness import find_workers
from kleinkram.server.jobs.queue import queue_ages_s
from kleinkram.server.settings import Settings
from kleinkram.server.tables import backup_attempt, blob, run, runner, scrub, upload
from kleinkram.server.tables.runs import ASSIGNED

_BLOBS = select(
    blob.c.state,
    blob.c.content,
    blob.c.marked_for_deletion_at.is_not(None).label("is_marked"),
    func.count().label("number"),
    func.sum(blob.c.size_bytes).label("size_bytes"),
).group_by(blob.c.state, blob.c.content, "is_marked")
_UPLOADS = select(upload.c.state, func.count().label("number")).group_by(upload.c.state)
_VISIBLE = text(
    "SELECT (SELECT count(*) FROM project WHERE deleted_at IS NULL) AS projects,"
    " (SELECT count(*) FROM mission m JOIN project p ON p.id = m.project_id"
    "  WHERE m.deleted_at IS NULL AND p.deleted_at IS NULL) AS missions,"
    " (SELECT count(*) FROM file f JOIN mission m ON m.id = f.mission_id JOIN project p ON p.id = m.project_id"
    "  WHERE f.deleted_at IS NULL AND m.deleted_at IS NULL AND p.deleted_at IS NULL) AS files"
)
_TRASH = text("""
WITH dead AS (
  SELECT DISTINCT f.blob_id FROM file f JOIN mission m ON m.id = f.mission_id JOIN project p ON p.id = m.project_id
    WHERE f.deleted_at IS NOT NULL OR m.deleted_at IS NOT NULL OR p.deleted_at IS NOT NULL
)
SELECT coalesce(sum(b.size_bytes), 0) FROM dead JOIN blob b ON b.id = dead.blob_id WHERE NOT EXISTS (
  SELECT 1 FROM file f JOIN mission m ON m.id = f.mission_id JOIN project p ON p.id = m.project_id
    WHERE f.blob_id = b.id AND f.deleted_at IS NULL AND m.deleted_at IS NULL AND p.deleted_at IS NULL
)
""")
_QUOTAS = text("""
WITH limited AS (
  SELECT id, quota_bytes, quota_files FROM project
    WHERE deleted_at IS NULL AND (quota_bytes IS NOT NULL OR quota_files IS NOT NULL)
), sizes AS (
  SELECT m.project_id, b.size_bytes FROM limited JOIN mission m ON m.project_id = limited.id
      JOIN file f ON f.mission_id = m.id JOIN blob b ON b.id = f.blob_id
    WHERE f.deleted_at IS NULL AND m.deleted_at IS NULL
  UNION ALL
  SELECT m.project_id, u.size_bytes FROM limited JOIN mission m ON m.project_id = limited.id
      JOIN upload u ON u.mission_id = m.id
    WHERE u.state IN ('open', 'completing') AND m.deleted_at IS NULL
), used AS (SELECT project_id, count(*) AS files, sum(size_bytes) AS bytes FROM sizes GROUP BY project_id),
shares AS (
  SELECT coalesce(bytes, 0)::float8 / nullif(quota_bytes, 0) AS bytes,
      coalesce(files, 0)::float8 / nullif(quota_files, 0) AS files
    FROM limited LEFT JOIN used ON used.project_id = limited.id
)
SELECT coalesce(max(bytes), 0) AS bytes, coalesce(max(files), 0) AS files,
  count(*) FILTER (WHERE bytes >= 0.9) AS near_bytes, count(*) FILTER (WHERE files >= 0.9) AS near_files FROM shares
""")
_DATABASE_SIZE = text("SELECT pg_database_size(current_database())")
_SERVER = text(
    "SELECT clock_timestamp() AS now, current_setting('max_connections')::int AS connections_max,"
    " (SELECT count(*) FROM pg_stat_activity WHERE backend_type = 'client backend') AS connections"
)
_JOBS = text(
    "SELECT task_name, status::text AS status, count(*) AS number,"
    " count(*) FILTER (WHERE status = 'todo' AND attempts > 0) AS retrying FROM procrastinate_jobs GROUP BY 1, 2"
)
_IS_ALIVE = runner.c.last_seen_at > func.now() - datetime.timedelta(seconds=LEASE_S)
_IS_EXPECTED = runner.c.last_seen_at > func.now() - datetime.timedelta(days=7)
_RUNNERS = select(
    func.count().filter(_IS_ALIVE).label("alive"),
    func.count().filter(_IS_EXPECTED, ~_IS_ALIVE).label("silent"),
    func.max(runner.c.last_seen_at).label("last_seen_at"),
)
_RUNS = (
    select(
        run.c.state,
        func.count().label("number"),
        func.extract("epoch", func.now() - func.min(run.c.created_at)).label("oldest_s"),
    )
    .where((run.c.state == "queued") | run.c.state.in_(ASSIGNED))
    .group_by(run.c.state)
)
_OLDEST_VERIFICATION = select(func.coalesce(func.extract("epoch", func.now() - func.min(blob.c.verified_at)), 0)).where(
    blob.c.state == BlobState.verified.value, blob.c.marked_for_deletion_at.is_(None)
)
_SCRUB = select(scrub).where(scrub.c.ended_at.is_not(None)).order_by(scrub.c.ended_at.desc()).limit(1)
_BACKUP = select(backup_attempt).order_by(backup_attempt.c.ended_at.desc()).limit(1)
_BACKUP_COMPLETE = _BACKUP.where(backup_attempt.c.snapshot_id.is_not(None))


async def read_gauges(db: Connection) -> list[Metric]:
    """Return the gauges that are read for each scrape."""
    return [
        *await _job_gauges(db),
        *await _worker_gauges(db),
        *await _run_gauges(db),
        *await _verification_gauges(db),
        *await _backup_gauges(db),
        *await _server_gauges(db),
    ]


async def read_slow_gauges(db: Connection, settings: Settings) -> list[Metric]:
    """Return the gauges whose cost grows with the number of files."""
    states, sizes, contents, marked_bytes = Counter[str](), Counter[str](), Counter[str](), 0
    for row in await db.execute(_BLOBS):
        if row.is_marked:
            marked_bytes += int(row.size_bytes)
            continue
        states[row.state] += row.number
        sizes[row.state] += int(row.size_bytes)
        contents[row.content] += row.number
    uploads = {row.state: row.number for row in await db.execute(_UPLOADS)}
    visible = (await db.execute(_VISIBLE)).one()
    trash_bytes = (await db.execute(_TRASH)).scalar_one()
    quotas = (await db.execute(_QUOTAS)).one()
    return [
        _by_label(definitions.BLOBS, states),
        _by_label(definitions.STORED_BYTES, sizes),
        _by_label(definitions.BLOB_CONTENT, contents),
        *_store_gauges(settings, sum(sizes.values())),
        _gauge(definitions.MARKED_FOR_DELETION_BYTES, marked_bytes),
        _gauge(definitions.TRASH_BYTES, int(trash_bytes)),
        _by_label(definitions.UPLOADS, uploads),
        _gauge(definitions.PROJECTS, visible.projects),
        _gauge(definitions.MISSIONS, visible.missions),
        _gauge(definitions.FILES, visible.files),
        _by_label(definitions.QUOTA_USED_RATIO, {"bytes": quotas.bytes, "files": quotas.files}),
        _by_label(definitions.PROJECTS_NEAR_QUOTA, {"bytes": quotas.near_bytes, "files": quotas.near_files}),
        _gauge(definitions.DATABASE_SIZE_BYTES, (await db.execute(_DATABASE_SIZE)).scalar_one()),
    ]


async def _job_gauges(db: Connection) -> list[Metric]:
    jobs = GaugeMetricFamily(definitions.JOBS.name, definitions.JOBS.meaning, labels=definitions.JOBS.labels)
    retrying = Counter[str]()
    for row in await db.execute(_JOBS):
        jobs.add_metric([row.task_name, row.status], row.number)
        if row.retrying:
            retrying[row.task_name] += row.retrying
    return [
        jobs,
        _by_label(definitions.JOBS_RETRYING, retrying),
        _by_label(definitions.QUEUE_OLDEST_SECONDS, await queue_ages_s(db)),
    ]


async def _worker_gauges(db: Connection) -> list[Metric]:
    workers = await find_workers(db)
    return [
        _gauge(definitions.WORKERS, len(workers.seen_at)),
        _time(definitions.WORKER_LAST_HEARTBEAT, workers.last_seen_at),
    ]


async def _run_gauges(db: Connection) -> list[Metric]:
    runners = (await db.execute(_RUNNERS)).one()
    runs = {row.state: row for row in await db.execute(_RUNS)}
    oldest_s = float(runs["queued"].oldest_s) if "queued" in runs else 0.0
    return [
        _by_label(definitions.RUNNERS, {"alive": runners.alive, "silent": runners.silent}),
        _time(definitions.RUNNER_LAST_SEEN, runners.last_seen_at),
        _by_label(definitions.RUNS, {state: row.number for state, row in runs.items()}),
        _gauge(definitions.RUNS_QUEUED_OLDEST_SECONDS, oldest_s),
    ]


async def _verification_gauges(db: Connection) -> list[Metric]:
    age_s = float((await db.execute(_OLDEST_VERIFICATION)).scalar_one())
    oldest = _gauge(definitions.OLDEST_VERIFICATION_SECONDS, age_s)
    last = (await db.execute(_SCRUB)).one_or_none()
    if last is None:
        return [oldest]
    findings = {name: getattr(last, name) for name in definitions.SCRUB_FINDINGS.values}
    return [
        oldest,
        _time(definitions.SCRUB_ENDED, last.ended_at),
        _gauge(definitions.SCRUB_STOPPED, int(last.aborted_reason is not None)),
        _gauge(definitions.SCRUB_COMPARED, last.compared),
        _by_label(definitions.SCRUB_FINDINGS, findings),
    ]


class BackupAttempt(NamedTuple):
    """An attempt at a backup; `snapshot_id` is None if it failed. `started_at`: the moment that the backup shows."""

    id: uuid.UUID
    started_at: datetime.datetime
    ended_at: datetime.datetime
    snapshot_id: str | None
    damaged_objects: int


async def last_backups(db: Connection) -> tuple[BackupAttempt | None, BackupAttempt | None]:
    """Return the last attempt at a backup, and the last complete one."""
    rows = [(await db.execute(stmt)).one_or_none() for stmt in (_BACKUP, _BACKUP_COMPLETE)]
    last, complete = (None if row is None else BackupAttempt._make(row) for row in rows)
    return last, complete


async def _backup_gauges(db: Connection) -> list[Metric]:
    last, complete = await last_backups(db)
    return [
        _time(definitions.BACKUP_LAST_SUCCESS, None if complete is None else complete.started_at),
        _time(definitions.BACKUP_LAST_ATTEMPT, None if last is None else last.ended_at),
        _gauge(definitions.BACKUP_LAST_ATTEMPT_FAILED, int(last is not None and last.snapshot_id is None)),
        _gauge(definitions.BACKUP_DAMAGED_OBJECTS, 0 if complete is None else complete.damaged_objects),
    ]


async def _server_gauges(db: Connection) -> list[Metric]:
    server = (await db.execute(_SERVER)).one()
    ahead = server.now - datetime.datetime.now(datetime.timezone.utc)
    return [
        _gauge(definitions.DATABASE_SERVER_CONNECTIONS, server.connections),
        _gauge(definitions.DATABASE_SERVER_CONNECTIONS_MAX, server.connections_max),
        _gauge(definitions.DATABASE_CLOCK_OFFSET_SECONDS, ahead.total_seconds()),
    ]


def _store_gauges(settings: Settings, stored_bytes: int) -> list[Metric]:
    """Of the store's disk if it is on this machine, otherwise by the given capacity."""
    if settings.store_folder is not None and settings.store_folder.is_dir():
        disk = shutil.disk_usage(settings.store_folder)
        free, size = disk.free, disk.total
    elif settings.store_capacity_bytes is not None:
        free, size = max(0, settings.store_capacity_bytes - stored_bytes), settings.store_capacity_bytes
    else:
        return []
    return [_gauge(definitions.STORE_FREE_BYTES, free), _gauge(definitions.STORE_SIZE_BYTES, size)]


def _gauge(definition: MetricDefinition, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(definition.name, definition.meaning, value=value)


def _time(definition: MetricDefinition, at: datetime.datetime | None) -> GaugeMetricFamily:
    return _gauge(definition, at.timestamp() if at is not None else 0)


def _by_label(definition: MetricDefinition, values: Mapping[str, float]) -> GaugeMetricFamily:
    """Return a gauge with one label; known values that are missing are 0."""
    family = GaugeMetricFamily(definition.name, definition.meaning, labels=definition.labels)
    for label_value, value in {**dict.fromkeys(definition.values, 0), **values}.items():
        family.add_metric([label_value], value)
    return family
