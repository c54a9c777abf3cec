"""Direct access to the database and jobs of a running server, for upload tests."""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Coroutine
from types import SimpleNamespace
from typing import Any, TypeVar, cast

from procrastinate import JobContext
from sqlalchemy import text

from kleinkram.server.blobs import jobs
from kleinkram.server.blobs.readers import ReaderProcesses
from kleinkram.server.context import AppContext
from kleinkram.server.db import open_database
from kleinkram.server.jobs.execution import BackPressure
from kleinkram.server.s3.storage import open_storage
from tests.integration.api_server import Api

T = TypeVar("T")
_ALL_BLOBS = text(
    "UPDATE blob SET content = 'opaque', summarised_at = now() WHERE marked_for_deletion_at IS NULL RETURNING id"
)


class SiteThread:
    """A context with its own connections for direct access of tests, kept open in a thread."""

    def __init__(self, api: Api) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._ended = asyncio.Event()
        ready: asyncio.Future[AppContext] = asyncio.Future(loop=self._loop)
        self._task = asyncio.run_coroutine_threadsafe(self._stay(api, ready), self._loop)
        self.context = asyncio.run_coroutine_threadsafe(_result(ready), self._loop).result(30)

    async def _stay(self, api: Api, ready: "asyncio.Future[AppContext]") -> None:
        settings = api.app.state.settings
        database = open_database(settings, statement_timeout_s=None)
        async with open_storage(settings) as storage:
            ready.set_result(
                AppContext(database, storage.with_capabilities(api.app.state.storage.capabilities), settings)
            )
            await self._ended.wait()
        await database.close()

    def run(self, work: Callable[[AppContext], Coroutine[Any, Any, T]]) -> T:
        """Do something with the site."""
        return asyncio.run_coroutine_threadsafe(work(self.context), self._loop).result(60)

    def close(self) -> None:
        """Let go of everything."""
        self._loop.call_soon_threadsafe(self._ended.set)
        self._task.result(30)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(30)


async def _result(ready: "asyncio.Future[AppContext]") -> AppContext:
    return await ready


async def verify_all(context: AppContext) -> None:
    """Read every blob, as the worker does on its last try. All are bytes and no recording: nothing reads along."""
    async with context.database.begin() as db:
        rows = (await db.execute(_ALL_BLOBS)).scalars().all()
    back_pressure = BackPressure(context.database)
    back_pressure.end()
    async with ReaderProcesses() as readers:
        values = {"context": context, "back_pressure": back_pressure, "readers": readers}
        job = SimpleNamespace(attempts=99, priority=0)
        job_context = cast(JobContext, SimpleNamespace(additional_context=values, job=job))
        for blob_id in rows:
            await cast("Callable[..., Awaitable[None]]", jobs.verify_blob.func)(job_context, ref=str(blob_id))
