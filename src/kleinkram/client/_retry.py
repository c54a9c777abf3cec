"""Waiting between tries: growing, with jitter, and not for ever."""

import random
import time
from collections.abc import Callable

FIRST_WAIT_S = 0.25
LONGEST_WAIT_S = 4.0
# How long in all a request waits because the server notify so: a limit on how often one may ask ends within a minute.
LONGEST_RETRY_AFTER_S = 90.0


class Backoff:
    """The waits of one thing that is tried again. Not shared between threads.

    `wait` is what waits (seconds); a transfer gives one that a Ctrl-C ends.
    """

    def __init__(self, patience_s: float, wait: Callable[[float], object] = time.sleep) -> None:
        self._began_at = time.monotonic()
        self._ends_at = self._began_at + patience_s
        self._next_s = FIRST_WAIT_S
        self._retry_after_left_s = LONGEST_RETRY_AFTER_S
        self._wait = wait

    def lasting_s(self) -> float:
        """Return for how long it has been tried."""
        return time.monotonic() - self._began_at

    def excuse(self, waited_s: float) -> None:
        """Leave out of account how long something else was waited for."""
        self._ends_at += waited_s

    def wait_retry_after(self, wait_s: float) -> bool:
        """Wait as long as the server says, which costs no patience; return False, without waiting, for too long."""
        if not 0 < wait_s <= self._retry_after_left_s:
            return False
        self._retry_after_left_s -= wait_s
        self._ends_at += wait_s
        self._wait(wait_s)
        return True

    def pause(self, at_least_s: float = 0.0) -> bool:
        """Wait before the next try; return False, without waiting, when patience has run out."""
        wait_s = max(at_least_s, self._next_s * random.uniform(0.5, 1.0))  # noqa: S311  jitter is no secret
        self._next_s = min(self._next_s * 2, LONGEST_WAIT_S)
        if time.monotonic() + wait_s > self._ends_at:
            return False
        self._wait(wait_s)
        return True
