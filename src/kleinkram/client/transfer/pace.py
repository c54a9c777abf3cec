"""Not faster than asked: one allowance of bytes a second, shared by all threads of a transfer."""

import threading
import time
from collections.abc import Callable

from kleinkram.client.errors import InvalidInput


def check_limits(connections: int, bytes_per_s: float | None) -> None:
    """Refuse limits with which nothing would ever move.

    Raises:
        InvalidInput: one is not above zero.
    """
    if connections < 1:
        raise InvalidInput(what=f"connections={connections}", reason="it must be at least 1")
    if bytes_per_s is not None and not bytes_per_s > 0:
        raise InvalidInput(what=f"bytes_per_s={bytes_per_s}", reason="it must be above zero")


class Pace:
    """A token bucket that holds at most a quarter of a second's worth. Safe to share between threads."""

    def __init__(self, bytes_per_s: float | None, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = bytes_per_s
        self._clock = clock
        self._lock = threading.Lock()
        self._free_at = clock()

    def spend(self, size_bytes: int, wait: Callable[[float], object]) -> None:
        """Take the allowance for some bytes, calling `wait` (seconds) until it is there."""
        if self._rate is None:
            return
        with self._lock:
            now = self._clock()
            begins = max(self._free_at, now - 0.25)
            self._free_at = begins + size_bytes / self._rate
            delay_s = self._free_at - now
        if delay_s > 0:
            wait(delay_s)
