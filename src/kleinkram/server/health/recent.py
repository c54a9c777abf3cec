"""A cache for values that anybody may request at any rate: one lookup at a time.

A slow lookup is cached for longer, so that lookups take at most a tenth of the time.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

T = TypeVar("T")
_LOOKUP_TIME_FACTOR = 10


class Recent(Generic[T]):
    """The last result of a lookup and when it expires. Failed lookups are not cached."""

    def __init__(self, look_up: Callable[[], Awaitable[T]], *, holds_s: float) -> None:
        self._look_up = look_up
        self._lifetime_s = holds_s
        self._lock = asyncio.Lock()
        self._cached: tuple[float, T] | None = None

    async def get(self) -> T:
        """Return a value that has not expired; concurrent callers share one lookup."""
        async with self._lock:
            if self._cached is None or time.monotonic() > self._cached[0]:
                started = time.monotonic()
                value = await self._look_up()
                took_s = time.monotonic() - started
                self._cached = (time.monotonic() + max(self._lifetime_s, _LOOKUP_TIME_FACTOR * took_s), value)
            return self._cached[1]
