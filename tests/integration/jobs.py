"""Run background jobs inside a test until the queue is empty."""

import asyncio
import threading
import uuid
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import AsyncExitStack
from typing import Any, NamedTuple, TypeVar

from procrastinate import App, JobContext, PsycopgConnector
from procrastinate.periodic import PeriodicRegistry
from procrastinate.worker import Worker

from kleinkram.recordings import isolation
from kleinkram.server import worker
from kleinkram.server.blobs import readers as readers_module
from kleinkram.server.blobs.readers import ReaderProcesses
from kleinkram.server.context import AppContext
from kleinkram.server.db import open_database
from kleinkram.server.jobs.execution import BackPressure, record_failure
from kleinkram.server.jobs.origin import run_with_origin
from kleinkram.server.jobs.queue import queue
from kleinkram.server.overviews.jobs import DerivationDebounce, MetadataCache
from kleinkram.server.s3.storage import Storage, open_storage
from kleinkram.server.settings import Settings, plain_dsn
from tests.integration.api_server import Api

T = TypeVar("T")
# Once in ten minutes, a worker that starts would collect garbage: verify, derive and judge the blobs and missions
# that earlier tests only inserted, a thousand of each. Tests of periodic jobs call them.
_NO_PERIODIC_JOBS = PeriodicRegistry()  # type: ignore[no-untyped-call]  # as procrastinate has it
_DUE = "SELECT count(*) FROM procrastinate_jobs WHERE status = 'todo' AND coalesce(scheduled_at, now()) <= now()"


def run_jobs(api: Api, *, store: str | None = None) -> list[str]:
    """Run every job that waits, and those that they cause; with the store at another address, if one is given.

    Returns the name of each that ran.
    """
    assert worker.JOB_MODULES
    ran: list[str] = []
    while api.sql(_DUE) != [(0,)]:
        ran += in_worker(api, _run_due) if store is None else on_site(api, _run_due_once, store=store)
    return ran


class WorkerResources(NamedTuple):
    """What a worker holds open between jobs."""

    context: AppContext
    connector: PsycopgConnector
    readers: ReaderProcesses


class _TestWorker:
    """An event loop in a thread of its own, with connections that stay open until the API ends.

    With new ones for each round, a round costs 0.1 s of CPU time: PostgreSQL starts processes for them, and SQLAlchemy
    compiles each statement again.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="test-worker", daemon=True)
        self._thread.start()
        self._opened = AsyncExitStack()
        self._database = open_database(settings, statement_timeout_s=None)
        try:
            self._storage, self._connector, self._readers = self.run(self._open())
        except BaseException:
            self.close()
            raise

    async def _open(self) -> tuple[Storage, PsycopgConnector, ReaderProcesses]:
        self._opened.push_async_callback(self._database.close)
        storage = await self._opened.enter_async_context(open_storage(self.settings))
        connector = _connector(self.settings)
        await connector.open_async()
        self._opened.push_async_callback(connector.close_async)
        return storage, connector, await self._opened.enter_async_context(ReaderProcesses())

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Wait for a coroutine that runs in the loop."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def resources(self, api: Api) -> WorkerResources:
        """Return what jobs need; the store has the capabilities that the API has found."""
        storage = self._storage.with_capabilities(api.app.state.storage.capabilities)
        return WorkerResources(AppContext(self._database, storage, self.settings), self._connector, self._readers)

    def close(self) -> None:
        """Close the connections and the loop."""
        self.run(self._opened.aclose())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


_workers: dict[str, _TestWorker] = {}
_starting = threading.Lock()


def in_worker(api: Api, work: Callable[[WorkerResources], Coroutine[Any, Any, T]]) -> T:
    """Do something with the connections of the worker of an API."""
    with _starting:
        test_worker = _workers.get(api.url)
        if test_worker is None:
            test_worker = _workers[api.url] = _TestWorker(api.app.state.settings)
            api.at_end.callback(lambda: _workers.pop(api.url).close())
    return test_worker.run(work(test_worker.resources(api)))


async def _run_due(resources: WorkerResources) -> list[str]:
    async with AsyncExitStack() as stack:
        app = stack.enter_context(queue.replace_connector(resources.connector))
        # A test may have replaced the program of children.
        is_usual = vars(readers_module)["CHILD_COMMAND"] is isolation.CHILD_COMMAND
        readers = resources.readers if is_usual else await stack.enter_async_context(ReaderProcesses())
        back_pressure = _no_back_pressure(resources.context)
        return await _drain(app, resources.context, readers, back_pressure, _NoRests())


async def _run_due_once(context: AppContext) -> list[str]:
    return await drain(context, _no_back_pressure(context))


def _no_back_pressure(context: AppContext) -> BackPressure:
    """Jobs need not wait for uploads that tests left unfinished."""
    back_pressure = BackPressure(context.database)
    back_pressure.end()
    return back_pressure


class _NoRests(DerivationDebounce):
    """No pauses after derivation, so that all jobs run before a test continues, on slow machines too."""

    def took(self, mission_id: uuid.UUID, seconds: float) -> None:
        """Do nothing."""


async def drain(context: AppContext, back_pressure: BackPressure, rests: DerivationDebounce | None = None) -> list[str]:
    """Run what waits, as courteous as it is given; returns the name of each job."""
    with queue.replace_connector(_connector(context.settings)) as app:
        async with app.open_async(), ReaderProcesses() as readers:
            return await _drain(app, context, readers, back_pressure, rests or _NoRests())


def _connector(settings: Settings) -> PsycopgConnector:
    return PsycopgConnector(conninfo=plain_dsn(settings.database_url), min_size=1, max_size=4)


async def _drain(
    app: App, context: AppContext, readers: ReaderProcesses, back_pressure: BackPressure, rests: DerivationDebounce
) -> list[str]:
    ran: list[str] = []
    app.periodic_registry = _NO_PERIODIC_JOBS

    async def note(call_next: Callable[[], Awaitable[Any]], job_context: JobContext, _worker: Worker) -> Any:
        ran.append(job_context.job.task_name)
        return await call_next()

    await app.run_worker_async(
        wait=False,
        concurrency=4,
        install_signal_handlers=False,
        listen_notify=False,
        worker_middleware=[run_with_origin, record_failure, note],
        additional_context={
            "context": context,
            "readers": readers,
            "back_pressure": back_pressure,
            "metadata_cache": MetadataCache(readers),
            "derivation_debounce": rests,
        },
    )
    return ran


def on_site(api: Api, work: Callable[[AppContext], Awaitable[T]], *, store: str | None = None) -> T:
    """Do something as a job would; with the store at another address, if one is given."""
    if store is None:
        return in_worker(api, lambda resources: _await(work(resources.context)))
    settings: Settings = api.app.state.settings.model_copy(update={"s3_internal_url": store})

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


async def _await(work: Awaitable[T]) -> T:
    return await work
