"""Run background jobs inside a test until the queue is empty."""

import asyncio
import uuid
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from procrastinate import JobContext, PsycopgConnector
from procrastinate.worker import Worker

from kleinkram.server import worker
from kleinkram.server.blobs.readers import ReaderProcesses
from kleinkram.server.context import AppContext
from kleinkram.server.db import open_database
from kleinkram.server.jobs.execution import BackPressure, record_failure
from kleinkram.server.jobs.queue import queue
from kleinkram.server.overviews.jobs import DerivationDebounce, MetadataCache
from kleinkram.server.s3.storage import open_storage
from kleinkram.server.settings import Settings, plain_dsn
from tests.integration.api_server import Api

T = TypeVar("T")
_DUE = "SELECT count(*) FROM procrastinate_jobs WHERE status = 'todo' AND coalesce(scheduled_at, now()) <= now()"


def run_jobs(api: Api, *, store: str | None = None) -> list[str]:
    """Run every job that waits, and those that they cause; with the store at another address, if one is given.

    Returns the name of each that ran.
    """
    assert worker.JOB_MODULES
    ran: list[str] = []
    while api.sql(_DUE) != [(0,)]:
        ran += on_site(api, _hurry, store=store)
    return ran


async def _hurry(context: AppContext) -> list[str]:
    back_pressure = BackPressure(context.database)
    back_pressure.end()  # jobs need not wait for uploads that tests left unfinished
    return await drain(context, back_pressure)


class _NoRests(DerivationDebounce):
    """No pauses after derivation, so that all jobs run before a test continues, on slow machines too."""

    def took(self, mission_id: uuid.UUID, seconds: float) -> None:
        """Do nothing."""


async def drain(context: AppContext, back_pressure: BackPressure, rests: DerivationDebounce | None = None) -> list[str]:
    """Run what waits, as courteous as it is given; returns the name of each job."""
    ran: list[str] = []

    async def note(call_next: Callable[[], Awaitable[Any]], job_context: JobContext, _worker: Worker) -> Any:
        ran.append(job_context.job.task_name)
        return await call_next()

    connector = PsycopgConnector(conninfo=plain_dsn(context.settings.database_url), min_size=1, max_size=4)
    with queue.replace_connector(connector) as app:
        async with app.open_async(), ReaderProcesses() as readers:
            await app.run_worker_async(
                wait=False,
                concurrency=4,
                install_signal_handlers=False,
                listen_notify=False,
                worker_middleware=[record_failure, note],
                additional_context={
                    "context": context,
                    "readers": readers,
                    "back_pressure": back_pressure,
                    "metadata_cache": MetadataCache(readers),
                    "derivation_debounce": rests or _NoRests(),
                },
            )
    return ran


def on_site(api: Api, work: Callable[[AppContext], Awaitable[T]], *, store: str | None = None) -> T:
    """Do something with a database and a store of its own, as a job would."""
    settings: Settings = api.app.state.settings
    if store is not None:
        settings = settings.model_copy(update={"s3_internal_url": store})

    async def run() -> T:
        database = open_database(settings, statement_timeout_s=None)
        try:
            async with open_storage(settings) as storage:
                return await work(
                    AppContext(database, storage.with_capabilities(api.app.state.storage.capabilities), settings)
                )
        finally:
            await database.close()

    return asyncio.run(run())
