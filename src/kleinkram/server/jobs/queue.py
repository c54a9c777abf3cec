"""The queue: procrastinate in the same PostgreSQL. Jobs are enqueued inside the transaction that causes them."""

import enum
import uuid
from collections.abc import Sequence

from procrastinate import App, PsycopgConnector
from procrastinate.types import JSONValue
from sqlalchemy import ColumnElement, Text, cast, column, exists, literal, select, table, text

from kleinkram.server.db import Connection, driver_connection


class Job(str, enum.Enum):
    """Every job there is."""

    summarise_blob = "summarise_blob"
    prove_blob = "prove_blob"
    group_recordings = "group_recordings"
    finish_uploads = "finish_uploads"
    sweep = "sweep"


class Urgency(enum.IntEnum):
    """What a person waits for goes before what only has to happen."""

    whenever = 0
    soon = 10


# Proving reads everything once: it has a lane of its own, so that nobody waits behind it.
PROVING = "proving"
DEFAULT = "default"
_LANES = {Job.prove_blob: PROVING}

# The worker gives it a connector of its own; the API enqueues over its own transactions.
queue = App(connector=PsycopgConnector())


async def enqueue(db: Connection, job: Job, *, ids: Sequence[str], urgency: Urgency) -> None:
    """Enqueue one job for each id, as part of the caller's transaction."""
    if ids:
        deferrer = queue.configure_task(
            job.value,
            queue=_LANES.get(job, DEFAULT),
            priority=int(urgency),
            connection=await driver_connection(db),
        )
        arguments: list[dict[str, JSONValue]] = [{"ref": each} for each in ids]
        await deferrer.batch_defer_async(*arguments)


_jobs = table("procrastinate_jobs", column("task_name"), column("status"), column("args"))


def has_job(job: Job, ref: ColumnElement[uuid.UUID]) -> ColumnElement[bool]:
    """Say of a row whether a job for its id waits or runs."""
    # The literal states are those of the index on this table, which the migration made for this question.
    alive = text("status IN ('todo', 'doing')")
    own = _jobs.c.args.op("->>")("ref") == cast(ref, Text)
    return exists(select(literal(1)).select_from(_jobs).where(_jobs.c.task_name == job.value, alive, own))
