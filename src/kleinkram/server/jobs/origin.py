"""The origin of a job: the request that caused it, directly or by another job.

`enqueue` stores it with the job, so that the job's log lines have the id of the request, and its span belongs to the
same trace. A periodic job has none. In PostgreSQL, the column takes it from a setting of the transaction, because
procrastinate's function inserts the rows.
"""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

from procrastinate import JobContext
from procrastinate.worker import Worker
from pydantic_core import to_json
from sqlalchemy import text
from sqlalchemy.exc import SQLAlchemyError

from kleinkram import traces
from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.json_logs import bound_fields, log_fields
from kleinkram.server.db import Database
from kleinkram.server.jobs.execution import app_context

# The job has not begun meanwhile: the worker would take it for one that was left unfinished, and run it twice.
_TIMEOUT_S = 5.0
_ORIGIN = text("SELECT origin FROM procrastinate_jobs WHERE id = :id")


class JobOrigin(NamedTuple):
    """The id of a request, and the `traceparent` of the span under which it enqueued a job."""

    request_id: str | None = None
    traceparent: str | None = None


def origin_here() -> str:
    """Return the origin of jobs that are enqueued here, as JSON; empty if there is none."""
    ids = {"request_id": bound_fields().get("request_id"), "traceparent": traces.traceparent()}
    known = {name: value for name, value in ids.items() if value is not None}
    return to_json(known).decode() if known else ""


async def run_with_origin(call_next: Callable[[], Awaitable[Any]], job_context: JobContext, _worker: Worker) -> Any:
    """Run a job with the ids of its origin in its log lines, and as a span if its origin has one."""
    job = job_context.job
    origin = await _find_origin(app_context(job_context).database, job.id)
    ref = job.task_kwargs.get("ref")
    fields = {"job": job.task_name, "job_id": job.id, "ref": ref, "attempt": job.attempts + 1}
    with log_fields(request_id=origin.request_id, **fields):
        if origin.traceparent is None:  # a periodic job alone is no trace
            return await call_next()
        attributes: traces.Attributes = {
            "messaging.system": "procrastinate",
            "messaging.operation.type": "process",
            "messaging.destination.name": job.queue,
            "messaging.message.id": str(job.id),
            "kleinkram.job": job.task_name,
            "kleinkram.ref": str(ref),
            "kleinkram.attempt": job.attempts + 1,
            "kleinkram.request_id": origin.request_id or "",
        }
        name = f"process {job.task_name}"
        with traces.span(name, attributes, kind=traces.Kind.consumer, parent=origin.traceparent):
            return await call_next()


async def _find_origin(database: Database, job_id: int | None) -> JobOrigin:
    async def read() -> dict[str, str] | None:
        async with database.autocommit() as db:
            origin: dict[str, str] | None = (await db.execute(_ORIGIN, {"id": job_id})).scalar_one_or_none()
            return origin

    try:
        origin = await asyncio.wait_for(read(), _TIMEOUT_S)
    except (DatabaseUnavailable, SQLAlchemyError, asyncio.TimeoutError):  # away, busy, or its schema is older
        return JobOrigin()
    # A program of a later version may have stored more.
    return JobOrigin(origin.get("request_id"), origin.get("traceparent")) if origin else JobOrigin()
