"""Ends of asyncio tasks that run in the background."""

import asyncio

_CANCEL_AGAIN_S = 1.0


async def cancel_and_wait(*tasks: asyncio.Task[None]) -> None:
    """Cancel tasks until all have ended; their errors are dropped.

    Once is not enough: a task that is cancelled just when what it waits for has happened goes on, for example in
    `asyncio.wait_for` before Python 3.12.
    """
    pending = {*tasks}
    while pending:
        for task in pending:
            task.cancel()
        _, pending = await asyncio.wait(pending, timeout=_CANCEL_AGAIN_S)
    await asyncio.gather(*tasks, return_exceptions=True)
