"""What anybody may ask, as often as they like: looked up once, by one at a time, and good for a moment.

What took long to look up is good for longer: of all time, at most a tenth is spent looking.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

T = TypeVar("T")
_TIMES = 10


class Recent(Generic[T]):
    """The last answer to one question, and when it was found. A look that fails is not kept."""

    def __init__(self, look: Callable[[], Awaitable[T]], *, holds_s: float) -> None:
        self._look = look
        self._holds_s = holds_s
        self._looking = asyncio.Lock()
        self._found: tuple[float, T] | None = None

    async def get(self) -> T:
        """Return an answer no older than it holds; whoever asks during a look waits for that one."""
        async with self._looking:
            if self._found is None or time.monotonic() > self._found[0]:
                began = time.monotonic()
                answer = await self._look()
                took_s = time.monotonic() - began
                self._found = (time.monotonic() + max(self._holds_s, _TIMES * took_s), answer)
            return self._found[1]
