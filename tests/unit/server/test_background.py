"""Background tasks end although a cancellation is lost."""

import asyncio
import contextlib

import pytest
from procrastinate import App
from procrastinate.testing import InMemoryConnector

from kleinkram.server.background import cancel_and_wait
from kleinkram.server.worker import _QueueWorker


async def _lose_a_cancellation() -> None:
    with contextlib.suppress(asyncio.CancelledError):
        await asyncio.sleep(60)


def test_a_task_that_loses_a_cancellation_is_cancelled_again() -> None:
    async def work() -> None:
        await _lose_a_cancellation()
        await asyncio.sleep(60)

    async def run() -> asyncio.Task[None]:
        task = asyncio.create_task(work())
        await asyncio.sleep(0)
        await asyncio.wait_for(cancel_and_wait(task), 30)
        return task

    assert asyncio.run(run()).cancelled()


def test_the_error_of_an_ended_task_is_dropped() -> None:
    async def fail() -> None:
        raise ValueError("lost")

    async def run() -> bool:
        task = asyncio.create_task(fail())
        await asyncio.sleep(0)
        await cancel_and_wait(task)
        return task.done()

    assert asyncio.run(run())


def test_a_queue_ends_although_its_cancellation_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    async def prune(_: object) -> None:
        await _lose_a_cancellation()

    async def run() -> None:
        app = App(connector=InMemoryConnector())
        monkeypatch.setattr(app.job_manager, "prune_stalled_workers", prune)
        queue = _QueueWorker(app, {}, "default", 1)
        async with app.open_async():
            task = asyncio.create_task(queue.run())
            await asyncio.sleep(0)
            queue.stop()
            task.cancel()
            await asyncio.wait_for(task, 30)

    asyncio.run(run())
