"""Attempts at jobs: the resources of the worker, retries, metrics, and the error of a failed job for admins.

The stored error is one sentence without secrets and signed URLs; the log has everything.
"""

import logging
import re
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from procrastinate import JobContext, RetryStrategy
from procrastinate.worker import Worker
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import SQLAlchemyError

from kleinkram.contract.errors import DatabaseUnavailable, KleinkramError
from kleinkram.server import metrics
from kleinkram.server.context import AppContext
from kleinkram.server.jobs.back_pressure import BackPressure
from kleinkram.server.tables import job_error

T = TypeVar("T")
ATTEMPTS = 5
# After 4, 16, 64 and 256 s, which outlasts a store that is away for minutes.
RETRY_STRATEGY = RetryStrategy(max_attempts=ATTEMPTS, exponential_wait=4)
_log = logging.getLogger("kleinkram.worker")
_MAX_CHARACTERS = 500
# Signatures of URLs are in the query, passwords before the host.
_QUERY = re.compile(r"\?\S+")
_PASSWORD = re.compile(r"(://[^\s/:@]*:)[^\s/@]+@")


@dataclass
class Attempts:
    """The ids of the jobs that this process runs, and of its present and past lanes."""

    running: set[int] = field(default_factory=set)
    lanes: set[int] = field(default_factory=set)


def worker_resource(job_context: JobContext, name: str, kind: type[T]) -> T:
    """Return a resource that the worker shares with its jobs."""
    resource = job_context.additional_context[name]
    if not isinstance(resource, kind):
        raise TypeError(f"the worker was started without its {name}")
    return resource


def app_context(job_context: JobContext) -> AppContext:
    """Return the database, store and settings."""
    return worker_resource(job_context, "context", AppContext)


def back_pressure_of(job_context: JobContext) -> BackPressure:
    """Return what delays jobs while uploads come in."""
    return worker_resource(job_context, "back_pressure", BackPressure)


async def record_failure(call_next: Callable[[], Awaitable[Any]], job_context: JobContext, worker: Worker) -> Any:
    """Run a job and count it; if it fails, log and store the error before the queue updates the job."""
    job, started = job_context.job, time.monotonic()
    outcome = "aborted"  # cancelled, unless something else comes first
    attempts = job_context.additional_context.get("attempts")
    if isinstance(attempts, Attempts) and job.id is not None and worker.worker_id is not None:
        attempts.running.add(job.id)
        attempts.lanes.add(worker.worker_id)
    try:
        result = await call_next()
        outcome = "succeeded"
        return result
    except Exception as error:
        retry = job_context.task.get_retry_exception(error, job)
        # Periodic jobs run again anyway, so the absence of the database is no failure of theirs.
        has_next_round = isinstance(error, DatabaseUnavailable) and job_context.task.queueing_lock is not None
        outcome = "given_up" if retry is None and not has_next_round else "failed"
        sentence = error_sentence(error)
        next_at = retry.retry_decision.retry_at if retry is not None else None
        fields = {"job": job.task_name, "id": job.id, "ref": job.task_kwargs.get("ref"), "attempt": job.attempts + 1}
        _log.warning(
            f"job failed: {sentence}", extra={"fields": {**fields, "outcome": outcome, "next_attempt_at": next_at}}
        )
        if has_next_round:
            return None
        if job.id is not None:
            row = upsert(job_error).values(job_id=job.id, sentence=sentence)
            row = row.on_conflict_do_update(index_elements=["job_id"], set_={"sentence": sentence})
            try:
                async with app_context(job_context).database.begin() as db:
                    await db.execute(row)
            except (SQLAlchemyError, KleinkramError) as store_error:  # must not replace the error of the job
                _log.warning("error not stored", extra={"fields": {"id": job.id, "reason": str(store_error)}})
        raise
    finally:
        metrics.JOB_ATTEMPTS.labels(job.task_name, outcome).inc()
        metrics.JOB_SECONDS.labels(job.task_name).observe(time.monotonic() - started)
        if isinstance(attempts, Attempts) and job.id is not None:
            attempts.running.discard(job.id)


def error_sentence(error: Exception) -> str:
    """Return an error in one line: its own sentence, if it has one."""
    lines = str(error).strip().splitlines()
    sentence = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
    if isinstance(error, KleinkramError):
        sentence = error.sentence()
    printable = "".join(letter if letter.isprintable() else " " for letter in sentence)
    return _PASSWORD.sub(r"\1…@", _QUERY.sub("?…", printable))[:_MAX_CHARACTERS]
