"""The state of the server for admins: store, jobs, scrubs, health and settings."""

import datetime
from typing import Any

from sqlalchemy import Select, exists, func, select, text

import kleinkram
from kleinkram.contract import admin
from kleinkram.contract.errors import NotAuthenticated, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.runs import RunState
from kleinkram.diagnostics import DiagnosticSeverity, find_problems
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs import scrub
from kleinkram.server.blobs.scrub import ScrubRow
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.health.readiness import check_service, find_workers
from kleinkram.server.home.service import is_low, store_use
from kleinkram.server.migrations import HEAD
from kleinkram.server.runs.eligibility import NEEDS_COLUMNS, QueuedRuns, known_runners, to_needs
from kleinkram.server.settings import Settings, is_secret
from kleinkram.server.tables import blob, file, mission, project, run, upload
from kleinkram.server.tables.blobs import UNDER_WAY

_QUEUE = text(
    "SELECT j.task_name AS kind, j.status::text AS state, count(*) AS count,"
    " min(e.at) FILTER (WHERE j.status = 'todo') AS oldest_at FROM procrastinate_jobs j"
    " LEFT JOIN procrastinate_events e ON e.job_id = j.id AND e.type = 'deferred'"
    " WHERE j.status IN ('todo', 'doing', 'failed') GROUP BY 1, 2 ORDER BY 1, 2"
)
_FAILED = text(
    "SELECT j.id, j.task_name AS kind, j.args ->> 'ref' AS ref, j.attempts, why.sentence AS error,"
    " (SELECT max(e.at) FROM procrastinate_events e WHERE e.job_id = j.id AND e.type = 'failed') AS failed_at"
    " FROM procrastinate_jobs j LEFT JOIN job_error why ON why.job_id = j.id"
    " WHERE j.status = 'failed' ORDER BY j.id DESC LIMIT 100"
)
_RETRYING = text(
    "SELECT j.id, j.task_name AS kind, j.args ->> 'ref' AS ref, j.attempts, why.sentence AS error,"
    " j.scheduled_at AS next_attempt_at FROM procrastinate_jobs j LEFT JOIN job_error why ON why.job_id = j.id"
    " WHERE j.status = 'todo' AND j.attempts > 0 ORDER BY j.id LIMIT 100"
)
_RETRY = text(
    "UPDATE procrastinate_jobs SET status = 'todo', attempts = 0, scheduled_at = NULL, worker_id = NULL"
    " WHERE id = :id AND status = 'failed' RETURNING task_name"
)
_RETRY_ALL = text(
    "WITH retried AS (UPDATE procrastinate_jobs SET status = 'todo', attempts = 0, scheduled_at = NULL,"
    " worker_id = NULL WHERE status = 'failed' RETURNING 1) SELECT count(*) FROM retried"
)
_SERVER = text(
    "SELECT clock_timestamp() AS now, current_setting('server_version') AS version,"
    " pg_database_size(current_database()) AS size_bytes"
)
_NUMBER = func.count().label("number")
_BLOB_BYTES = func.coalesce(func.sum(blob.c.size_bytes), 0).label("size_bytes")
_UPLOAD_BYTES = func.coalesce(func.sum(upload.c.size_bytes), 0).label("size_bytes")


async def get_storage(db: Connection, settings: Settings) -> admin.AdminStorage:
    """Return what is in the store, by state."""
    blobs = select(_NUMBER, _BLOB_BYTES).where(blob.c.marked_for_deletion_at.is_(None))
    of_blob = exists().where(file.c.blob_id == blob.c.id)
    is_live = of_blob.where(
        file.c.deleted_at.is_(None),
        mission.c.id == file.c.mission_id,
        mission.c.deleted_at.is_(None),
        project.c.id == mission.c.project_id,
        project.c.deleted_at.is_(None),
    )
    by_state = blobs.add_columns(blob.c.state).group_by(blob.c.state).order_by(blob.c.state)
    garbage = select(_NUMBER, _BLOB_BYTES).where(blob.c.marked_for_deletion_at.is_not(None))
    uploads = select(_NUMBER, _UPLOAD_BYTES).where(upload.c.state.in_(UNDER_WAY))
    return admin.AdminStorage(
        store=await store_use(db, settings),
        is_low=is_low(settings),
        blobs=[
            admin.StateAmount(state=row.state, count=row.number, size_bytes=int(row.size_bytes))
            for row in await db.execute(by_state)
        ],
        trash=await _amount(db, "trash", blobs.where(of_blob, ~is_live)),
        uploads=await _amount(db, "under_way", uploads),
        marked_for_deletion=await _amount(db, "marked_for_deletion", garbage),
    )


async def _amount(db: Connection, state: str, stmt: Select[Any]) -> admin.StateAmount:
    row = (await db.execute(stmt)).one()
    return admin.StateAmount(state=state, count=row.number, size_bytes=int(row.size_bytes))


async def get_jobs(db: Connection) -> admin.AdminJobs:
    """Return the queue, the jobs that wait for another attempt, and the last failed ones."""
    return admin.AdminJobs(
        queue=[admin.JobAmount.model_validate(row._asdict()) for row in await db.execute(_QUEUE)],
        failed=[admin.FailedJob.model_validate(row._asdict()) for row in await db.execute(_FAILED)],
        retrying=[admin.RetryingJob.model_validate(row._asdict()) for row in await db.execute(_RETRYING)],
    )


async def retry_job(db: Connection, actor: Actor, job_id: int) -> None:
    """Requeue a failed job. Raises NotFound."""
    kind = (await db.execute(_RETRY, {"id": job_id})).scalar_one_or_none()
    if kind is None:
        raise NotFound(resource_type="failed job", ref=str(job_id))
    await audit(db, actor, Event("job.retry", "job", None, kind, after={"job": job_id}, needs_admin=True))


async def retry_jobs(db: Connection, actor: Actor) -> admin.RetriedJobs:
    """Requeue all failed jobs, and return their number."""
    count: int = (await db.execute(_RETRY_ALL)).scalar_one()
    if count:
        await audit(db, actor, Event("job.retry", "job", None, "all", after={"jobs": count}, needs_admin=True))
    return admin.RetriedJobs(count=count)


async def get_scrub(db: Connection, settings: Settings) -> admin.ScrubState:
    """Return the last scrub, and the blobs by state."""
    last = await scrub.last_scrub(db, settings.store_id)
    rows = await scrub.blobs_by_state(db)
    return admin.ScrubState(
        last=None if last is None else _to_scrub(last),
        every_hours=settings.scrub_hours,
        again_after_days=settings.reverify_days,
        oldest_verification_at=await scrub.oldest_verification(db),
        blobs=[admin.StateAmount(state=row.state, count=row.number, size_bytes=row.size_bytes) for row in rows],
    )


async def begin_scrub(db: Connection, actor: Actor, settings: Settings, *, accept_losses: bool) -> admin.ScrubRead:
    """Request a scrub and return it, or the one that is already running."""
    if actor.person_id is None:
        raise NotAuthenticated(reason="starting a scrub requires an account")
    row = await scrub.request_scrub(db, settings.store_id, by_id=actor.person_id, accept_losses=accept_losses)
    after: Metadata = {"accept_losses": accept_losses}
    await audit(db, actor, Event("store.scrub", "store", None, settings.store_id, after=after, needs_admin=True))
    return _to_scrub(row)


async def get_health(context: AppContext, *, takes_pages: bool) -> admin.AdminHealth:
    """Return the state of the server; asks the store without holding a connection."""
    results = await check_service(context.database, context.storage)
    live = (mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None), run.c.state == RunState.queued.value)
    queued = select(*NEEDS_COLUMNS, _NUMBER).join_from(run, mission).join(project).where(*live)
    async with context.database.begin() as db:
        server = (await db.execute(_SERVER)).one()
        now = datetime.datetime.now(datetime.timezone.utc)
        workers = await find_workers(db)
        known = await known_runners(db, context.settings.weakest_isolation)
        rows = await db.execute(queued.group_by(*NEEDS_COLUMNS).order_by(_NUMBER.desc()).limit(200))
        queued_runs = [QueuedRuns(to_needs(row._mapping), row.number) for row in rows]
    warnings = [
        f"{result.message} {result.remedy}" for result in results if result.severity is DiagnosticSeverity.warning
    ]
    return admin.AdminHealth(
        not_ready=next((result.message for result in find_problems(results)), None),
        warnings=warnings,
        version=kleinkram.__version__,
        schema_version=HEAD,
        database_version=server.version,
        database_bytes=server.size_bytes,
        now=now,
        clock_skew_s=(now - server.now).total_seconds(),
        workers_at=workers.seen_at,
        worker_last_at=workers.last_seen_at,
        runs_problem=known.runs_problem(queued_runs),
        invitation_warning=known.invitation_warning(),
        store_checksum=context.storage.checksum.value,
        store_refuses_overwrites=context.storage.capabilities.writes_once,
        store_allows_browser_uploads=takes_pages,
    )


def get_settings(settings: Settings) -> admin.AdminSettings:
    """Return every setting in force; of secrets, only whether they are set."""
    values = settings.model_dump(mode="json")
    return admin.AdminSettings(
        settings=[
            admin.SettingRead(
                name=f"KLEINKRAM_{name.upper()}",
                value=None if is_secret(name) else values[name],
                is_set=name in settings.model_fields_set,
                is_secret=is_secret(name),
            )
            for name in sorted(values)
        ]
    )


def _to_scrub(row: ScrubRow) -> admin.ScrubRead:
    return admin.ScrubRead.model_validate({name: getattr(row, name) for name in admin.ScrubRead.model_fields})
