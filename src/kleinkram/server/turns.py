"""Who comes next where many wait for a connection: whose request came first.

A request asks for connections several times. Were all who wait served in the order in which they ask, under load each
would wait as often at the end of the line, and those that ask for much would take many times as long as the others.
"""

import asyncio
import contextvars
import heapq
import itertools
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

_arrived: contextvars.ContextVar[float] = contextvars.ContextVar("arrived")


class NoTurn(Exception):
    """None was free in time."""


def note_arrival() -> None:
    """Note that a request has come in just now: all that its task asks for has this place in the line."""
    _arrived.set(time.monotonic())


class Turns:
    """So many at a time. What is no request waits from when it asks."""

    def __init__(self, count: int) -> None:
        self._free = count
        self._line: list[tuple[float, int, asyncio.Future[None]]] = []
        self._numbers = itertools.count()

    @asynccontextmanager
    async def taken(self, *, within_s: float) -> AsyncIterator[None]:
        """Hold a turn.

        Raises:
            NoTurn: none was free within this time.
        """
        await self._take(within_s)
        try:
            yield
        finally:
            self._pass_on()

    async def _take(self, within_s: float) -> None:
        if self._free:
            self._free -= 1
            return
        mine: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._line, (_arrived.get(time.monotonic()), next(self._numbers), mine))
        try:
            await asyncio.wait({mine}, timeout=within_s)
        except asyncio.CancelledError:
            if not mine.cancel():
                self._pass_on()  # it was given just then
            raise
        if mine.cancel():
            raise NoTurn

    def _pass_on(self) -> None:
        while self._line:
            *_, following = heapq.heappop(self._line)
            if not following.done():
                following.set_result(None)
                return
        self._free += 1
