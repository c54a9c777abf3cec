"""The worker: a process that runs the jobs of the queue, and requeues jobs of dead workers.

It survives a restart of PostgreSQL: each queue reconnects.
"""

import asyncio
import contextlib
import datetime
import logging
import signal
import time
from collections.abc import Iterable

import psycopg
from procrastinate import App, PsycopgConnector
from procrastinate.exceptions import ConnectorException
from procrastinate.jobs import Job as ProcrastinateJob
from procrastinate.jobs import Status
from procrastinate.worker import Worker

import kleinkram
from kleinkram.metric_definitions import MetricSource
from kleinkram.server import maintenance as _maintenance
from kleinkram.server.admin import jobs as _admin_jobs
from kleinkram.server.auth import jobs as _auth_jobs
from kleinkram.server.background import cancel_and_wait
from kleinkram.server.blobs import jobs as _blob_jobs
from kleinkram.server.blobs import preview_jobs as _preview_jobs
from kleinkram.server.blobs.readers import ReaderProcesses
from kleinkram.server.checks import jobs as _check_jobs
from kleinkram.server.context import AppContext
from kleinkram.server.db import Database, open_database
from kleinkram.server.health.metrics_server import serve_metrics
from kleinkram.server.health.readiness import heartbeat
from kleinkram.server.jobs.execution import Attempts, BackPressure, record_failure
from kleinkram.server.jobs.origin import run_with_origin
from kleinkram.server.jobs.queue import DEFAULT, DERIVATION, PREVIEWS, SMALL_BLOBS, VERIFICATION, queue
from kleinkram.server.overviews import jobs as _derivation_jobs
from kleinkram.server.overviews.jobs import DerivationDebounce, MetadataCache
from kleinkram.server.people import jobs as _people_jobs
from kleinkram.server.runs import jobs as _run_jobs
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.settings import Settings, plain_dsn
from kleinkram.server.uploads import jobs as _upload_jobs
from kleinkram.systemd import Watchdog, notify_ready, notify_status, notify_stopping

_log = logging.getLogger("kleinkram.worker")
_AT_ONCE = 3
_STALLED_CHECK_S = 20
# A worker that stops while the database is down waits for this time twice.
_POOL_TIMEOUT_S = 4.0
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 10.0
# After running for this long, the pauses start again with the shortest.
_STEADY_S = 30.0
# The database is away, refuses connections, or closed one. psycopg's own errors come from opening the pool.
_DATABASE_AWAY = (ConnectorException, psycopg.OperationalError)
# Importing the jobs of a feature registers them with the queue.
JOB_MODULES = (
    _admin_jobs,
    _blob_jobs,
    _preview_jobs,
    _maintenance,
    _run_jobs,
    _derivation_jobs,
    _check_jobs,
    _upload_jobs,
    _people_jobs,
    _auth_jobs,
)


async def run_worker(settings: Settings) -> None:
    """Run jobs until SIGTERM or SIGINT; running jobs are finished first, unless a second signal comes."""
    task = asyncio.current_task()
    stopping = asyncio.Event()

    def stop() -> None:
        # Cancelling is not enough: it can get lost, and the error of a database that is away can replace it.
        stopping.set()
        notify_stopping()
        if task is not None:
            task.cancel()

    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop)
    # Until the end: running jobs are finished after the signal.
    pings = asyncio.create_task(Watchdog().ping_from_event_loop())
    try:
        with contextlib.suppress(asyncio.CancelledError):
            await _open_and_run(settings, stopping)
    finally:
        pings.cancel()


async def _open_and_run(settings: Settings, stopping: asyncio.Event) -> None:
    pauses = _Pauses()
    while not stopping.is_set():
        connector = PsycopgConnector(
            conninfo=plain_dsn(settings.database_url), min_size=1, max_size=8, timeout=_POOL_TIMEOUT_S
        )
        # Periodic jobs belong to the app they were declared on, so that one is resources the worker's connector.
        with queue.replace_connector(connector) as app:
            try:
                async with app.open_async():
                    await _run(app, settings, stopping)
            except _DATABASE_AWAY as error:
                notify_status("waiting for the database")
                await pauses.wait("the worker", error, stopping)


class _Pauses:
    """Increasing pauses between attempts to reconnect to the database."""

    def __init__(self) -> None:
        self._pause_s = _FIRST_PAUSE_S
        self._began = time.monotonic()

    async def wait(self, what: str, error: Exception | None, stopping: asyncio.Event) -> None:
        """Log that `what` restarts, and wait; not longer than until `stopping`."""
        if time.monotonic() - self._began > _STEADY_S:
            self._pause_s = _FIRST_PAUSE_S
        reason = "a connection ended" if error is None else str(error.__cause__ or error).strip()
        fields = {"reason": reason.partition("\n")[0], "pause_s": self._pause_s}
        _log.warning(f"the database went away: {what} restarts after a pause", extra={"fields": fields})
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(stopping.wait(), self._pause_s)
        self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)
        self._began = time.monotonic()


async def _run(app: App, settings: Settings, stopping: asyncio.Event) -> None:
    database = open_database(settings, statement_timeout_s=None)
    try:
        await _run_queues(app, settings, database, stopping)
    finally:
        await database.close()


async def _run_queues(app: App, settings: Settings, database: Database, stopping: asyncio.Event) -> None:
    async with (
        open_storage(settings) as storage,
        ReaderProcesses() as readers,
        heartbeat(database),
        serve_metrics(settings, database, MetricSource.worker),
    ):
        back_pressure = BackPressure(database)
        attempts = Attempts()
        resources: dict[str, object] = {
            "context": AppContext(database, storage, settings),
            "readers": readers,
            "back_pressure": back_pressure,
            "metadata_cache": MetadataCache(readers),
            "derivation_debounce": DerivationDebounce(),
            "attempts": attempts,
        }
        queues = ((DEFAULT, _AT_ONCE), (VERIFICATION, 1), (SMALL_BLOBS, 1), (DERIVATION, 1), (PREVIEWS, 1))
        notify_ready("working")
        _log.info("working", extra={"fields": {"version": kleinkram.__version__}})
        queue_workers = [_QueueWorker(app, resources, name, at_once) for name, at_once in queues]
        working = [asyncio.create_task(one.run()) for one in queue_workers]
        others = [asyncio.create_task(_rescue_stalled(app, attempts)), asyncio.create_task(_wait_for(stopping))]
        try:
            # Beside the last, none ends by itself: one that does has failed, and ends the process, which is restarted.
            done, _ = await asyncio.wait([*working, *others], return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            back_pressure.end()
            for one, task in zip(queue_workers, working, strict=True):
                one.stop()
                task.cancel()  # or it waits for a database that is away
            await asyncio.gather(*working, return_exceptions=True)
            await cancel_and_wait(*others)


async def _wait_for(event: asyncio.Event) -> None:
    await event.wait()


class _QueueWorker:
    """Runs the jobs of one queue, `at_once` at the same time."""

    def __init__(self, app: App, resources: dict[str, object], name: str, at_once: int) -> None:
        self._app = app
        self._resources = resources
        self._name = name
        self._at_once = at_once
        self._worker: Worker | None = None
        self._is_stopping = asyncio.Event()

    async def run(self) -> None:
        """Run jobs until stopped, again after each loss of the database."""
        pauses = _Pauses()
        while not self._is_stopping.is_set():
            error: Exception | None = None  # a worker whose listener lost its connection ends without an error
            self._worker = self._new_worker()
            try:
                await self._worker.run()  # type: ignore[no-untyped-call]  # as procrastinate has it
            except _DATABASE_AWAY as raised:
                error = raised
            if not self._is_stopping.is_set():
                await pauses.wait(f"queue {self._name}", error, self._is_stopping)

    def stop(self) -> None:
        """Take no more jobs, and end once the running ones are finished. A cancellation alone can get lost."""
        self._is_stopping.set()
        if self._worker is not None:
            self._worker.stop()  # type: ignore[no-untyped-call]

    def _new_worker(self) -> Worker:
        return Worker(
            self._app,
            queues=[self._name],
            concurrency=self._at_once,
            install_signal_handlers=False,
            additional_context=self._resources,
            shutdown_graceful_timeout=20,
            fetch_job_polling_interval=2,
            update_heartbeat_interval=5,
            stalled_worker_timeout=20,
            delete_jobs="successful",
            worker_middleware=[run_with_origin, record_failure],
        )


async def _rescue_stalled(app: App, attempts: Attempts) -> None:
    """Put back the jobs of dead workers, and those of this worker whose end was not written to the database."""
    abandoned: set[int | None] = set()
    while True:
        try:
            stalled = [*await app.job_manager.get_stalled_jobs(seconds_since_heartbeat=_STALLED_CHECK_S)]
            ours = [*await _abandoned(app, attempts)]
            for job in [*stalled, *(job for job in ours if job.id in abandoned)]:
                await _rescue(app, job)
            # Twice in a row: the end of a job may be about to be written.
            abandoned = {job.id for job in ours}
        except _DATABASE_AWAY as error:  # the next round finds the same jobs
            _log.warning("stalled jobs not looked at", extra={"fields": {"reason": str(error)}})
        await asyncio.sleep(_STALLED_CHECK_S)


async def _abandoned(app: App, attempts: Attempts) -> Iterable[ProcrastinateJob]:
    """Return jobs that this process runs according to the queue, but does not."""
    doing = await app.job_manager.list_jobs_async(status=Status.DOING.value)
    return [job for job in doing if job.worker_id in attempts.worker_ids and job.id not in attempts.running]


async def _rescue(app: App, job: ProcrastinateJob) -> None:
    """Put one job back; a periodic one is deleted instead, because its next round is waiting already."""
    _log.warning(
        "job was left unfinished: it will run again", extra={"fields": {"job": job.task_name, "job_id": job.id}}
    )
    try:
        if job.queueing_lock is not None:
            await app.job_manager.finish_job(job, status=Status.FAILED, delete_job=True)
        else:
            await app.job_manager.retry_job(job, retry_at=datetime.datetime.now(datetime.timezone.utc))
    except ConnectorException as error:  # another worker took it, or the next round finds it
        _log.warning("job not requeued", extra={"fields": {"job_id": job.id, "reason": str(error)}})
