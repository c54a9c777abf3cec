"""What admins see of the whole server. Who may is decided by the table of operations."""

import datetime
from typing import Any

from sqlalchemy import Row, Select

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
from kleinkram.server.access.actor import Actor
from kleinkram.server.admin import queries
from kleinkram.server.audit.service import Event, record
from kleinkram.server.blobs import scrub
from kleinkram.server.blobs.scrub import ScrubRow
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.health.readiness import readiness
from kleinkram.server.health.worker_heartbeat import find_workers
from kleinkram.server.home.service import is_low, store_use
from kleinkram.server.migrations import HEAD
from kleinkram.server.runners.scheduling import (
    has_single_person,
    invitation_warning,
    known_runners,
    runs_problem,
)
from kleinkram.server.settings import Settings, is_secret


async def get_storage(db: Connection, settings: Settings) -> AdminStorage:
    """Return what the store keeps."""
    store = await store_use(db, settings)
    rows = (await db.execute(queries.blobs_by_state())).all()
    return AdminStorage(
        store=store,
        is_low=is_low(settings),
        blobs=[_amount(row.state, row) for row in rows],
        trash=await _sum(db, "trash", queries.trashed_blobs()),
        uploads=await _sum(db, "under_way", queries.open_uploads()),
        doomed=await _sum(db, "doomed", queries.doomed_blobs()),
    )


async def get_jobs(db: Connection) -> AdminJobs:
    """Return the queue, the jobs that wait for another attempt, and those that were given up last."""
    queue = (await db.execute(queries.QUEUE)).all()
    failed = (await db.execute(queries.FAILED)).all()
    retrying = (await db.execute(queries.RETRYING)).all()
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
    kind = (await db.execute(queries.RETRY, {"id": job_id})).scalar_one_or_none()
    if kind is None:
        raise NotFound(noun="failed job", ref=str(job_id))
    await record(db, actor, Event("job.retry", "job", None, kind, None, after={"job": job_id}, by_power=True))


async def retry_jobs(db: Connection, actor: Actor) -> RetriedJobs:
    """Put all jobs that were given up back into the queue, and return how many."""
    count: int = (await db.execute(queries.RETRY_ALL)).scalar_one()
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
        server = (await db.execute(queries.SERVER)).one()
        here = datetime.datetime.now(datetime.timezone.utc)
        workers = await find_workers(db)
        known, alone = await known_runners(db), await has_single_person(db)
        queued = (await db.execute(queries.queued_runs())).all()
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
