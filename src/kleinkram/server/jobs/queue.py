"""The queue: procrastinate in the same PostgreSQL. Jobs are enqueued inside the transaction that causes them."""

import enum
from collections.abc import Sequence

from procrastinate import App, PsycopgConnector
from procrastinate.types import JSONValue

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


# The worker gives it a connector of its own; the API enqueues over its own transactions.
queue = App(connector=PsycopgConnector())


async def enqueue(db: Connection, job: Job, *, ids: Sequence[str], urgency: Urgency) -> None:
    """Enqueue one job for each id, as part of the caller's transaction."""
    if ids:
        deferrer = queue.configure_task(job.value, priority=int(urgency), connection=await driver_connection(db))
        arguments: list[dict[str, JSONValue]] = [{"ref": each} for each in ids]
        await deferrer.batch_defer_async(*arguments)
