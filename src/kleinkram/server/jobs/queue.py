"""The queue: procrastinate in the same PostgreSQL. Jobs are enqueued inside the transaction that causes them."""

import datetime
import enum
import uuid
from collections.abc import Iterable, Sequence

from procrastinate import App, PsycopgConnector
from sqlalchemy import ColumnElement, Text, cast, column, exists, literal, select, table, text

from kleinkram.server.db import Connection
from kleinkram.server.jobs.origin import origin_here


class Job(str, enum.Enum):
    """All jobs. A value is stored with each job that waits, so it stays when the member gets a better name."""

    summarise_blob = "summarise_blob"
    verify_blob = "verify_blob"
    summarise_and_verify_blob = "examine_blob"
    make_recording_preview = "make_recording_preview"
    derive_recordings = "group_recordings"
    judge_mission = "judge_mission"
    judge_project = "judge_project"
    finish_uploads = "finish_uploads"
    maintain_runs = "maintain_runs"
    start_automatic_runs = "start_automatic_runs"
    collect_garbage = "collect_garbage"
    redact_audit_log = "redact_audit_log"
    expire_audit_log = "expire_audit_log"
    check_provider_accounts = "check_provider_accounts"
    scrub = "scrub"
    send_status_report = "send_status_report"


class Priority(enum.IntEnum):
    """Priority: work that a person waits for, then necessary work, then work that can wait."""

    low = -10
    normal = 0
    high = 10


# Verification reads everything once, small files come by the thousand, and derivation waits for uploads: each has its
# own queue, so that summaries do not wait for them; so have previews, which are made while others are verified. (With a
# lock for derivation, one retried mission would block all others.) The names of queues are stored, too.
VERIFICATION = "verification"
SMALL_BLOBS = "examining"
DERIVATION = "grouping"
PREVIEWS = "previews"
DEFAULT = "default"
_QUEUES = {
    Job.verify_blob: VERIFICATION,
    Job.summarise_and_verify_blob: SMALL_BLOBS,
    Job.derive_recordings: DERIVATION,
    Job.make_recording_preview: PREVIEWS,
}
# Of these, one job for the same id runs at a time: two would replace each other's objects.
_ONE_AT_A_TIME = frozenset((Job.make_recording_preview,))

_DELETE_FAILED = text(
    "DELETE FROM procrastinate_jobs j WHERE j.status IN ('failed', 'cancelled', 'aborted') AND NOT EXISTS"
    " (SELECT 1 FROM procrastinate_events e WHERE e.job_id = j.id AND e.at > now() - interval '7 days')"
)

# During an upgrade, a worker of the earlier version may take a job of a kind that it does not know. The queue then
# marks the job as failed without running it, so that no error is stored. Periodic jobs are due again anyway.
_REQUEUE_UNKNOWN = text(
    "UPDATE procrastinate_jobs j SET status = 'todo', attempts = 0, scheduled_at = NULL, worker_id = NULL"
    " WHERE status = 'failed' AND queueing_lock IS NULL AND task_name = ANY(:known)"
    " AND NOT EXISTS (SELECT 1 FROM job_error e WHERE e.job_id = j.id)"
)
_DELETE_UNKNOWN = text(
    "DELETE FROM procrastinate_jobs j WHERE status = 'failed' AND queueing_lock IS NOT NULL AND task_name = ANY(:known)"
    " AND NOT EXISTS (SELECT 1 FROM job_error e WHERE e.job_id = j.id)"
)

# The worker sets its own connector; the API enqueues in its own transactions.
queue = App(connector=PsycopgConnector())

# Calls the library's SQL function: its client would build, log and serialize each job. The column `origin` has the
# setting as its default; it is set first, because the function needs the rows that it joins.
_DEFER = text(
    "SELECT procrastinate_defer_jobs_v1(array_agg(ROW(CAST(:queue AS varchar), CAST(:task AS varchar),"
    " CAST(:priority AS integer), CAST(:lock AS text) || ref, NULL, jsonb_build_object('ref', ref),"
    " now() + CAST(:later AS interval))"
    "::procrastinate_job_to_defer_v1 ORDER BY number))"
    " FROM unnest(CAST(:ids AS text[])) WITH ORDINALITY AS given (ref, number)"
    " JOIN (SELECT set_config('kleinkram.job_origin', :origin, true) AS set) AS origin ON origin.set IS NOT NULL"
)

_RAISE_PRIORITY = text(
    "UPDATE procrastinate_jobs SET priority = :priority"
    " WHERE task_name = :task AND status = 'todo' AND args ->> 'ref' = :ref AND priority < :priority"
)
_START_NOW = text(
    "UPDATE procrastinate_jobs SET scheduled_at = NULL"
    " WHERE task_name = :task AND status = 'todo' AND args ->> 'ref' = :ref AND scheduled_at > now()"
)


async def enqueue(
    db: Connection, job: Job, *, ids: Sequence[str], priority: Priority, later: datetime.timedelta | None = None
) -> None:
    """Enqueue a job for each id, in order, in the caller's transaction; with `later`, to start after that time."""
    if ids:
        parameters = {"queue": _QUEUES.get(job, DEFAULT), "task": job.value, "priority": int(priority), "ids": [*ids]}
        lock = f"{job.value} " if job in _ONE_AT_A_TIME else None
        await db.execute(_DEFER, {**parameters, "lock": lock, "later": later, "origin": origin_here()})


async def raise_priority(db: Connection, job: Job, ref: uuid.UUID) -> None:
    """Raise the priority of the waiting job for an id."""
    await db.execute(_RAISE_PRIORITY, {"task": job.value, "ref": str(ref), "priority": int(Priority.high)})


async def start_now(db: Connection, job: Job, ref: uuid.UUID) -> None:
    """Like `raise_priority`; also start the job now if it is scheduled for later, such as a retry."""
    await raise_priority(db, job, ref)
    await db.execute(_START_NOW, {"task": job.value, "ref": str(ref)})


# In random order, so that two workers seldom choose the same.
_WAITING = text(
    "SELECT args ->> 'ref' FROM procrastinate_jobs WHERE task_name = :task AND status = 'todo'"
    " AND coalesce(scheduled_at, now()) <= now() ORDER BY random() LIMIT :most"
)
_DELETE_WAITING = text(
    "DELETE FROM procrastinate_jobs WHERE task_name = :task AND status = 'todo' AND args ->> 'ref' = ANY(:refs)"
)


async def waiting_ids(db: Connection, job: Job, *, most: int) -> list[uuid.UUID]:
    """Return at most `most` ids, in random order, whose job could start now."""
    rows = await db.execute(_WAITING, {"task": job.value, "most": most})
    return [uuid.UUID(ref) for ref in rows.scalars()]


async def delete_waiting(db: Connection, job: Job, ids: Iterable[uuid.UUID]) -> None:
    """Delete waiting jobs whose work the caller's transaction does."""
    await db.execute(_DELETE_WAITING, {"task": job.value, "refs": [str(job_id) for job_id in ids]})


_WITH_WAITING = text(
    "SELECT args ->> 'ref' FROM procrastinate_jobs WHERE task_name = :task AND status = 'todo'"
    " AND args ->> 'ref' = ANY(:refs)"
)


async def with_waiting_job(db: Connection, job: Job, refs: Sequence[str]) -> set[str]:
    """Return those of some ids for which a job waits."""
    return set((await db.execute(_WITH_WAITING, {"task": job.value, "refs": [*refs]})).scalars())


_ENQUEUED_AT = text("SELECT min(at) FROM procrastinate_events WHERE job_id = :id")


async def enqueued_at(db: Connection, job_id: int | None) -> datetime.datetime | None:
    """Return when a job was enqueued; None if unknown."""
    at: datetime.datetime | None = (await db.execute(_ENQUEUED_AT, {"id": job_id})).scalar()
    return at


# Ids ascend, so the lowest was deferred first. Jobs that wait for another attempt count from when they were first
# deferred; those put off on purpose do not.
_QUEUE_AGES = text(
    "SELECT queue_name, extract(epoch FROM now() - min(e.at)) AS seconds FROM"
    " (SELECT queue_name, min(id) AS id FROM procrastinate_jobs WHERE status = 'todo'"
    " AND (attempts > 0 OR scheduled_at IS NULL OR scheduled_at <= now()) GROUP BY queue_name) oldest"
    " JOIN procrastinate_events e ON e.job_id = oldest.id AND e.type = 'deferred' GROUP BY queue_name"
)


async def queue_ages_s(db: Connection) -> dict[str, float]:
    """Return for how many seconds the oldest job of each queue has been waiting, without queues where none waits."""
    return {row.queue_name: max(0.0, float(row.seconds)) for row in await db.execute(_QUEUE_AGES)}


_jobs = table("procrastinate_jobs", column("task_name"), column("status"), column("args"))


def has_job(job: Job, ref: ColumnElement[uuid.UUID]) -> ColumnElement[bool]:
    """Whether a job for the id of a row waits or runs."""
    # In the words of the partial index of the migration.
    alive = text("status IN ('todo', 'doing')")
    own = _jobs.c.args.op("->>")("ref") == cast(ref, Text)
    return exists(select(literal(1)).select_from(_jobs).where(_jobs.c.task_name == job.value, alive, own))


async def delete_failed_jobs(db: Connection) -> None:
    """Delete failed jobs after a week."""
    await db.execute(_DELETE_FAILED)


async def requeue_unknown_jobs(db: Connection) -> None:
    """Queue jobs again that a worker of an earlier version took and did not know."""
    known = {"known": [job.value for job in Job]}
    await db.execute(_DELETE_UNKNOWN, known)
    await db.execute(_REQUEUE_UNKNOWN, known)
