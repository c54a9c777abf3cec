"""The queue: procrastinate in the same PostgreSQL. Jobs are enqueued inside the transaction that causes them."""

from collections.abc import Mapping, Sequence

from procrastinate import App, PsycopgConnector
from procrastinate.tasks import Task

from kleinkram.server.db import Connection, driver_connection

# Priorities: what a person waits for, before what only has to happen.
SOON = 10
WHENEVER = 0

# The connector is opened by the worker only; the API enqueues over its own transactions.
queue = App(connector=PsycopgConnector())


async def enqueue(
    db: Connection, task: Task[..., object, ...], arguments: Sequence[Mapping[str, str]], *, priority: int
) -> None:
    """Enqueue one job for each set of arguments, as part of the caller's transaction."""
    if not arguments:
        return
    deferrer = task.configure(priority=priority, connection=await driver_connection(db))
    await deferrer.batch_defer_async(*(dict(each) for each in arguments))
