"""How fast bytes may go, how far it has come, and saying so on stderr: a line that is written over on a terminal."""

import asyncio
import sys
import time
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager

_TERMINAL_EVERY_S = 0.5
_ELSEWHERE_EVERY_S = 30.0


class Pace:
    """At most so many bytes a second by all who go through it; None for no limit. Counts them."""

    def __init__(self, bytes_per_s: float | None) -> None:
        self._bytes_per_s = bytes_per_s
        self._free_at = 0.0
        self.seen_bytes = 0

    async def slowed(self, pieces: AsyncIterator[bytes]) -> AsyncGenerator[bytes, None]:
        """Yield pieces no faster than that."""
        async for piece in pieces:
            self.seen_bytes += len(piece)
            if self._bytes_per_s is not None:
                now = time.monotonic()
                self._free_at = max(self._free_at, now) + len(piece) / self._bytes_per_s
                await asyncio.sleep(self._free_at - now)
            yield piece


@asynccontextmanager
async def telling(sentence: Callable[[], str], *, quiet: bool) -> AsyncGenerator[None, None]:
    """Say on stderr how far it is, until the block ends."""
    on_terminal = sys.stderr.isatty()
    if quiet:
        yield
        return
    task = asyncio.create_task(_tell(sentence, on_terminal=on_terminal))
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        if on_terminal:
            sys.stderr.write("\r\033[K")


async def _tell(sentence: Callable[[], str], *, on_terminal: bool) -> None:
    while True:
        await asyncio.sleep(_TERMINAL_EVERY_S if on_terminal else _ELSEWHERE_EVERY_S)
        sys.stderr.write(f"\r\033[K{sentence()}" if on_terminal else f"{sentence()}\n")
        sys.stderr.flush()


def amount(size_bytes: float) -> str:
    """Return bytes as a person reads them."""
    for unit in ("B", "kB", "MB", "GB"):
        if size_bytes < 1000:
            return f"{size_bytes:.0f} {unit}" if unit == "B" else f"{size_bytes:.1f} {unit}"
        size_bytes /= 1000
    return f"{size_bytes:.1f} TB"
