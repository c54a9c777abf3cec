"""The worker: one process that runs what the queue holds, and puts back what a dead worker left."""

import asyncio
import contextlib
import datetime
import logging
import signal

from procrastinate import App, PsycopgConnector

import kleinkram
from kleinkram.contract.uploads import ChecksumKind
from kleinkram.server.blobs import jobs as _blob_jobs
from kleinkram.server.db import open_database
from kleinkram.server.jobs.queue import queue
from kleinkram.server.recordings import jobs as _recording_jobs
from kleinkram.server.settings import Settings, plain_dsn
from kleinkram.server.site import Site
from kleinkram.server.storage import open_storage
from kleinkram.server.uploads import jobs as _upload_jobs

_log = logging.getLogger("kleinkram.worker")
_AT_ONCE = 3
_STALLED_CHECK_S = 20
# Importing a feature's jobs is what makes the queue know them.
JOB_MODULES = (_blob_jobs, _recording_jobs, _upload_jobs)


async def run_worker(settings: Settings) -> None:
    """Run jobs until SIGTERM or SIGINT; a job under way is finished first, unless a second signal comes."""
    task = asyncio.current_task()
    if task is not None:
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await _open_and_run(settings)


async def _open_and_run(settings: Settings) -> None:
    connector = PsycopgConnector(conninfo=plain_dsn(settings.database_url), min_size=1, max_size=4)
    # Periodic jobs belong to the app they were declared on, so that one is given the worker's connector.
    with queue.replace_connector(connector) as app:
        await _run(app, settings)


async def _run(app: App, settings: Settings) -> None:
    database = open_database(settings)
    async with app.open_async(), open_storage(settings, ChecksumKind.crc64nvme) as storage:
        site = Site(database, storage, settings)
        _log.info("working", extra={"fields": {"version": kleinkram.__version__}})
        rescue = asyncio.create_task(_rescue_stalled(app))
        try:
            await app.run_worker_async(
                concurrency=_AT_ONCE,
                install_signal_handlers=False,
                additional_context={"site": site},
                shutdown_graceful_timeout=20,
                fetch_job_polling_interval=2,
                update_heartbeat_interval=5,
                stalled_worker_timeout=20,
                delete_jobs="successful",
            )
        finally:
            rescue.cancel()
            await database.close()


async def _rescue_stalled(app: App) -> None:
    """Put back jobs whose worker died."""
    while True:
        for job in await app.job_manager.get_stalled_jobs(seconds_since_heartbeat=_STALLED_CHECK_S):
            _log.warning("job put back", extra={"fields": {"job": job.task_name, "id": job.id}})
            await app.job_manager.retry_job(job, retry_at=datetime.datetime.now(datetime.timezone.utc))
        await asyncio.sleep(_STALLED_CHECK_S)
