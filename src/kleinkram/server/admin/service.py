"""What admins ask of the database. Of the queue by its own tables, which have no nouns here."""

import datetime
from typing import Any

from sqlalchemy import Row, Select, exists, func, select, text

import kleinkram
from kleinkram.contract.admin import (
    AdminHealth,
    AdminJobs,
    AdminSettings,
    AdminStorage,
    FailedJob,
    JobAmount,
    RetriedJobs,
    RetryingJob,
    ScrubRead,
    ScrubState,
    SettingRead,
    StateAmount,
)
from kleinkram.contract.errors import NotAuthenticated, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.runs import RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit.service import Event, record
from kleinkram.server.blobs import scrub
from kleinkram.server.blobs.scrub import ScrubRow
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.health.readiness import find_workers, readiness
from kleinkram.server.home.service import is_low, store_use
from kleinkram.server.migrations import HEAD
from kleinkram.server.runners.eligibility import (
    Needs,
    has_single_person,
    invitation_warning,
    known_runners,
    runs_problem,
)
from kleinkram.server.settings import Settings, is_secret
from kleinkram.server.tables import blob, file, mission, project, run, upload
from kleinkram.server.tables.upload import UNDER_WAY

_SUM = func.coalesce(func.sum(blob.c.size_bytes), 0).label("size_bytes")
QUEUE = text(
    "SELECT j.task_name AS kind, j.status::text AS state, count(*) AS number,"
    " min(e.at) FILTER (WHERE j.status = 'todo') AS oldest_at FROM procrastinate_jobs j"
    " LEFT JOIN procrastinate_events e ON e.job_id = j.id AND e.type = 'deferred'"
    " WHERE j.status IN ('todo', 'doing', 'failed') GROUP BY 1, 2 ORDER BY 1, 2"
)
FAILED = text(
    "SELECT j.id, j.task_name AS kind, j.args ->> 'ref' AS ref, j.attempts, why.sentence AS error,"
    " (SELECT max(e.at) FROM procrastinate_events e WHERE e.job_id = j.id AND e.type = 'failed') AS failed_at"
    " FROM procrastinate_jobs j LEFT JOIN job_error why ON why.job_id = j.id"
    " WHERE j.status = 'failed' ORDER BY j.id DESC LIMIT 100"
)
RETRYING = text(
    "SELECT j.id, j.task_name AS kind, j.args ->> 'ref' AS ref, j.attempts, why.sentence AS error,"
    " j.scheduled_at AS next_attempt_at FROM procrastinate_jobs j LEFT JOIN job_error why ON why.job_id = j.id"
    " WHERE j.status = 'todo' AND j.attempts > 0 ORDER BY j.id LIMIT 100"
)
RETRY = text(
    "UPDATE procrastinate_jobs SET status = 'todo', attempts = 0, scheduled_at = NULL, worker_id = NULL"
    " WHERE id = :id AND status = 'failed' RETURNING task_name"
)
RETRY_ALL = text(
    "WITH retried AS (UPDATE procrastinate_jobs SET status = 'todo', attempts = 0, scheduled_at = NULL,"
    " worker_id = NULL WHERE status = 'failed' RETURNING 1) SELECT count(*) FROM retried"
)
SERVER = text(
    "SELECT clock_timestamp() AS now, current_setting('server_version') AS version,"
    " pg_database_size(current_database()) AS size_bytes"
)


def queued_runs() -> Select[Any]:
    """Return what queued runs need of a runner, under the names of `Needs`, and how many need the same."""
    needs = [mission.c.project_id, *(run.c[name] for name in Needs._fields if name != "project_id")]
    live = (mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None), run.c.state == RunState.queued.value)
    joined = select(*needs, func.count().label("number")).join_from(run, mission).join(project)
    return joined.where(*live).group_by(*needs).order_by(func.count().desc()).limit(200)


def blobs_by_state() -> Select[Any]:
    """Return number and bytes of blobs by state."""
    stmt = select(blob.c.state, func.count().label("number"), _SUM).where(blob.c.doomed_at.is_(None))
    return stmt.group_by(blob.c.state).order_by(blob.c.state)


def doomed_blobs() -> Select[Any]:
    """Return number and bytes of blobs that nothing refers to: they go with the next sweeps."""
    return select(func.count().label("number"), _SUM).where(blob.c.doomed_at.is_not(None))


def trashed_blobs() -> Select[Any]:
    """Return number and bytes of blobs that only files in the trash are made of."""
    of_blob = exists().where(file.c.blob_id == blob.c.id)
    live = of_blob.where(
        file.c.deleted_at.is_(None),
        mission.c.id == file.c.mission_id,
        mission.c.deleted_at.is_(None),
        project.c.id == mission.c.project_id,
        project.c.deleted_at.is_(None),
    )
    stmt = select(func.count().label("number"), _SUM).where(blob.c.doomed_at.is_(None))
    return stmt.where(of_blob, ~live)


def open_uploads() -> Select[Any]:
    """Return number and bytes of the uploads under way."""
    size_bytes = func.coalesce(func.sum(upload.c.size_bytes), 0).label("size_bytes")
    return select(func.count().label("number"), size_bytes).where(upload.c.state.in_(UNDER_WAY))


async def get_storage(db: Connection, settings: Settings) -> AdminStorage:
    """Return what the store keeps."""
    store = await store_use(db, settings)
    rows = (await db.execute(blobs_by_state())).all()
    return AdminStorage(
        store=store,
        is_low=is_low(settings),
        blobs=[_amount(row.state, row) for row in rows],
        trash=await _sum(db, "trash", trashed_blobs()),
        uploads=await _sum(db, "under_way", open_uploads()),
        doomed=await _sum(db, "doomed", doomed_blobs()),
    )


async def get_jobs(db: Connection) -> AdminJobs:
    """Return the queue, the jobs that wait for another attempt, and those that were given up last."""
    queue = (await db.execute(QUEUE)).all()
    failed = (await db.execute(FAILED)).all()
    retrying = (await db.execute(RETRYING)).all()
    return AdminJobs(
        queue=[JobAmount(kind=row.kind, state=row.state, count=row.number, oldest_at=row.oldest_at) for row in queue],
        failed=[FailedJob.model_validate(row._asdict()) for row in failed],
        retrying=[RetryingJob.model_validate(row._asdict()) for row in retrying],
    )


async def retry_job(db: Connection, actor: Actor, job_id: int) -> None:
    """Put a job that was given up back into the queue.

    Raises:
        NotFound: there is no such job, or it was not given up.
    """
    kind = (await db.execute(RETRY, {"id": job_id})).scalar_one_or_none()
    if kind is None:
        raise NotFound(noun="failed job", ref=str(job_id))
    await record(db, actor, Event("job.retry", "job", None, kind, None, after={"job": job_id}, by_power=True))


async def retry_jobs(db: Connection, actor: Actor) -> RetriedJobs:
    """Put all jobs that were given up back into the queue, and return how many."""
    count: int = (await db.execute(RETRY_ALL)).scalar_one()
    if count:
        await record(db, actor, Event("job.retry", "job", None, "all", None, after={"jobs": count}, by_power=True))
    return RetriedJobs(count=count)


async def get_scrub(db: Connection, settings: Settings) -> ScrubState:
    """Return the last scrub, and how the blobs are."""
    last = await scrub.last_scrub(db, settings.store_id)
    rows = await scrub.blobs_by_state(db)
    return ScrubState(
        last=None if last is None else _scrub(last),
        every_hours=settings.scrub_hours,
        again_after_days=settings.reverify_days,
        oldest_verification_at=await scrub.oldest_verification(db),
        blobs=[StateAmount(state=row.state, count=row.number, size_bytes=row.size_bytes) for row in rows],
    )


async def begin_scrub(db: Connection, actor: Actor, settings: Settings, *, believe: bool) -> ScrubRead:
    """Have the store's list compared with the database, and return the scrub: the one under way, or one that begins."""
    if actor.person_id is None:
        raise NotAuthenticated(reason="starting a scrub requires an account")
    row = await scrub.request_scrub(db, settings.store_id, by_id=actor.person_id, believes=believe)
    after: Metadata = {"believe": believe}
    await record(db, actor, Event("store.scrub", "store", None, settings.store_id, None, after=after, by_power=True))
    return _scrub(row)


async def get_health(context: AppContext, *, takes_pages: bool) -> AdminHealth:
    """Return how the server is; asks the store without holding a connection."""
    found = await readiness(context.database, context.storage)
    async with context.database.begin() as db:
        server = (await db.execute(SERVER)).one()
        here = datetime.datetime.now(datetime.timezone.utc)
        workers = await find_workers(db)
        known, alone = await known_runners(db), await has_single_person(db)
        queued = (await db.execute(queued_runs())).all()
    return AdminHealth(
        not_ready=found.missing,
        warnings=list(found.warnings),
        version=kleinkram.__version__,
        schema_version=HEAD,
        database_version=server.version,
        database_bytes=server.size_bytes,
        now=here,
        clock_skew_s=(here - server.now).total_seconds(),
        workers_at=workers.seen_at,
        worker_last_at=workers.last_seen_at,
        runs_problem=runs_problem(queued, known, single_person=alone),
        invitation_warning=invitation_warning(known, single_person=alone),
        store_checksum=context.storage.checksum.value,
        store_writes_once=context.storage.capabilities.writes_once,
        store_takes_pages=takes_pages,
    )


def get_settings(settings: Settings) -> AdminSettings:
    """Return every setting in force; of secrets, that they are set."""
    said = settings.model_dump(mode="json")
    return AdminSettings(
        settings=[
            SettingRead(
                name=f"KLEINKRAM_{name.upper()}",
                value=None if is_secret(name) else said[name],
                is_set=name in settings.model_fields_set,
                is_secret=is_secret(name),
            )
            for name in sorted(said)
        ]
    )


def _scrub(row: ScrubRow) -> ScrubRead:
    return ScrubRead.model_validate({name: getattr(row, name) for name in ScrubRead.model_fields})


async def _sum(db: Connection, state: str, statement: Select[Any]) -> StateAmount:
    return _amount(state, (await db.execute(statement)).one())


def _amount(state: str, row: Row[Any]) -> StateAmount:
    return StateAmount(state=state, count=row.number, size_bytes=int(row.size_bytes))
