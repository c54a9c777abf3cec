"""What the worker gives its jobs to work with, and how often they try."""

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
from kleinkram.server.jobs.courtesy import Courtesy
from kleinkram.server.tables import job_error

T = TypeVar("T")
ATTEMPTS = 5
# Waits of 4, 16, 64, 256 s: a store that is away for minutes costs nothing but patience.
PATIENTLY = RetryStrategy(max_attempts=ATTEMPTS, exponential_wait=4)


def given(job_context: JobContext, name: str, kind: type[T]) -> T:
    """Return one of the things that the worker gave its jobs to work with."""
    thing = job_context.additional_context[name]
    if not isinstance(thing, kind):
        raise TypeError(f"the worker was started without its {name}")
    return thing


def app_context(job_context: JobContext) -> AppContext:
    """Return the job's way to database and store."""
    return given(job_context, "site", AppContext)


def courtesy_of(job_context: JobContext) -> Courtesy:
    """Return what makes the job wait while uploads come in."""
    return given(job_context, "courtesy", Courtesy)


_log = logging.getLogger("kleinkram.worker")
_MOST_CHARACTERS = 500
# What signs an address of the store stands in its query; a password stands before the host.
_QUERY = re.compile(r"\?\S+")
_PASSWORD = re.compile(r"(://[^\s/:@]*:)[^\s/@]+@")


@dataclass
class Attempts:
    """What this process runs now: ids of jobs, and the queue's ids of its lanes, past ones among them."""

    running: set[int] = field(default_factory=set)
    lanes: set[int] = field(default_factory=set)


async def keep_why(call_next: Callable[[], Awaitable[Any]], job_context: JobContext, worker: Worker) -> Any:
    """Run a job and count it; where it fails, log and keep why, before the queue hears of it."""
    job, began = job_context.job, time.monotonic()
    outcome = "aborted"  # cancelled, unless something else comes first
    attempts = job_context.additional_context.get("attempts")
    if isinstance(attempts, Attempts) and job.id is not None and worker.worker_id is not None:
        attempts.running.add(job.id)
        attempts.lanes.add(worker.worker_id)
    try:
        answer = await call_next()
        outcome = "succeeded"
        return answer
    except Exception as error:
        retry = job_context.task.get_retry_exception(error, job)
        # A periodic job's next round comes by itself: what the database's absence ended is no failure to look into.
        has_next_round = isinstance(error, DatabaseUnavailable) and job_context.task.queueing_lock is not None
        outcome = "given_up" if retry is None and not has_next_round else "failed"
        sentence = sentence_of(error)
        next_at = retry.retry_decision.retry_at if retry is not None else None
        fields = {"job": job.task_name, "id": job.id, "ref": job.task_kwargs.get("ref"), "attempt": job.attempts + 1}
        _log.warning(
            f"job failed: {sentence}", extra={"fields": {**fields, "outcome": outcome, "next_attempt_at": next_at}}
        )
        if has_next_round:
            return None
        if job.id is not None:
            await _keep(app_context(job_context), job.id, sentence)
        raise
    finally:
        metrics.JOB_ATTEMPTS.labels(job.task_name, outcome).inc()
        metrics.JOB_SECONDS.labels(job.task_name).observe(time.monotonic() - began)
        if isinstance(attempts, Attempts) and job.id is not None:
            attempts.running.discard(job.id)


def sentence_of(error: Exception) -> str:
    """Return one line that says what went wrong: an error's own sentence where it has one."""
    said = error.sentence() if isinstance(error, KleinkramError) else _named(error)
    shown = "".join(letter if letter.isprintable() else " " for letter in said)
    return _PASSWORD.sub(r"\1…@", _QUERY.sub("?…", shown))[:_MOST_CHARACTERS]


def _named(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


async def _keep(context: AppContext, job_id: int, sentence: str) -> None:
    row = upsert(job_error).values(job_id=job_id, sentence=sentence)
    try:
        async with context.database.begin() as db:
            await db.execute(row.on_conflict_do_update(index_elements=["job_id"], set_={"sentence": sentence}))
    except (SQLAlchemyError, KleinkramError) as error:  # what the job itself failed of must not be lost to this
        _log.warning("why a job failed was not kept", extra={"fields": {"id": job_id, "reason": str(error)}})
