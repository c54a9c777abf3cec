"""How the worker runs jobs: shared resources, back-pressure, retries, metrics, and the errors that admins see.

A stored error is one sentence without secrets and signed URLs; the log has everything.
"""

import asyncio
import contextlib
import datetime
import logging
import re
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from procrastinate import JobContext, RetryStrategy
from procrastinate.worker import Worker
from sqlalchemy import exists, func, select
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import SQLAlchemyError

from kleinkram.contract.errors import DatabaseUnavailable, KleinkramError
from kleinkram.contract.uploads import UploadState
from kleinkram.server import metrics
from kleinkram.server.context import AppContext
from kleinkram.server.db import Database
from kleinkram.server.tables import job_error, upload

T = TypeVar("T")
ATTEMPTS = 5
# After 4, 16, 64 and 256 s, which outlasts a store that is away for minutes.
RETRY_STRATEGY = RetryStrategy(max_attempts=ATTEMPTS, exponential_wait=4)
_log = logging.getLogger("kleinkram.worker")
_MAX_CHARACTERS = 500
# Signatures of URLs are in the query, passwords before the host.
_QUERY = re.compile(r"\?\S+")
_PASSWORD = re.compile(r"(://[^\s/:@]*:)[^\s/@]+@")
SUMMARY_MAX_WAIT_S = 10.0
VERIFY_MAX_WAIT_S = 30.0
# Clients that send small files sign parts several times a second; slow clients leave this machine enough time.
_RECENT_S = 2.0
_POLL_S = 0.5
# The interval between jobs that have waited long enough: each of ten thousand small files is a job.
_START_INTERVAL_S = 0.2


class BackPressure:
    """Delays jobs while uploads come in: on a small machine, reading new files would slow uploads down.

    Each job is delayed for a limited time after its cause. Then jobs run one after another, a few per second, as long
    as uploads come in. There is one object per worker.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._ended = asyncio.Event()
        self._next_start_at = 0.0
        recent = func.now() - datetime.timedelta(seconds=_RECENT_S)
        active = (upload.c.state == UploadState.open.value) & (upload.c.renewed_at > recent)
        self._stmt = select(func.now().label("now"), exists().where(active).label("is_busy"))

    async def wait_for_uploads(self, max_wait_s: float, *, since: datetime.datetime | None = None) -> bool:
        """Wait until no upload is active, or until `max_wait_s` after `since` (default: now).

        Returns True if uploads are still active, so that the work should be short.
        """
        while not self._ended.is_set():
            async with self._database.autocommit() as db:
                row = (await db.execute(self._stmt)).one()
            since = since or row.now
            left_s = max_wait_s - (row.now - since).total_seconds()
            if not row.is_busy:
                return False
            if left_s <= 0:
                now = time.monotonic()
                start_at = max(now, self._next_start_at)
                self._next_start_at = start_at + _START_INTERVAL_S
                await self._wait(start_at - now)
                return True
            await self._wait(min(left_s, _POLL_S))
        return False

    async def _wait(self, seconds: float) -> None:
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._ended.wait(), seconds)

    def end(self) -> None:
        """End all waiting."""
        self._ended.set()


@dataclass
class Attempts:
    """The ids of the jobs that this process runs, and its present and past worker ids, one per queue."""

    running: set[int] = field(default_factory=set)
    worker_ids: set[int] = field(default_factory=set)


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
    """Return the delay of jobs while uploads come in."""
    return worker_resource(job_context, "back_pressure", BackPressure)


async def record_failure(call_next: Callable[[], Awaitable[Any]], job_context: JobContext, worker: Worker) -> Any:
    """Run a job and count it; if it fails, log and store the error before the queue updates the job."""
    job, started = job_context.job, time.monotonic()
    outcome = "aborted"  # cancelled, unless something else comes first
    attempts = job_context.additional_context.get("attempts")
    if isinstance(attempts, Attempts) and job.id is not None and worker.worker_id is not None:
        attempts.running.add(job.id)
        attempts.worker_ids.add(worker.worker_id)
    try:
        _log.debug("job started")
        with metrics.JOBS_IN_PROGRESS.track_inprogress():
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
        _log.warning(f"job failed: {sentence}", extra={"fields": {"outcome": outcome, "next_attempt_at": next_at}})
        if has_next_round:
            return None
        if job.id is not None:
            row = upsert(job_error).values(job_id=job.id, sentence=sentence)
            row = row.on_conflict_do_update(index_elements=["job_id"], set_={"sentence": sentence})
            try:
                async with app_context(job_context).database.begin() as db:
                    await db.execute(row)
            except (SQLAlchemyError, KleinkramError) as store_error:  # must not replace the error of the job
                _log.warning("error not stored", extra={"fields": {"reason": str(store_error)}})
        raise
    finally:
        seconds = time.monotonic() - started
        metrics.JOB_ATTEMPTS.labels(job.task_name, outcome).inc()
        metrics.JOB_SECONDS.labels(job.task_name).observe(seconds)
        if outcome == "succeeded":
            # Periodic jobs, which have a queueing lock, mostly find nothing to do.
            level = logging.INFO if job.queueing_lock is None else logging.DEBUG
            _log.log(level, "job done", extra={"fields": {"duration_ms": round(seconds * 1000, 1)}})
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
