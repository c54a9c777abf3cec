"""Coordination of a transfer's threads: queues, budgets of work ahead, a rate limit, and one way to stop all."""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from kleinkram.client.errors import InvalidInput

T = TypeVar("T")


class Stopped(Exception):
    """The transfer is being stopped."""


class Stop:
    """Stops all threads of a transfer, and keeps the first failure. Waits on it raise `Stopped`."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._lock = threading.Lock()
        self._conditions: list[threading.Condition] = []
        self.failure: BaseException | None = None

    def condition(self) -> threading.Condition:
        """Return a condition that is notified at the stop."""
        condition = threading.Condition()
        with self._lock:
            self._conditions.append(condition)
        return condition

    def now(self, failure: BaseException | None = None) -> None:
        """Stop everything; only the first failure is kept."""
        with self._lock:
            if not self._event.is_set():
                self.failure = failure
            self._event.set()
            conditions = [*self._conditions]
        for condition in conditions:
            with condition:
                condition.notify_all()

    def check(self) -> None:
        """Raise `Stopped` if stopped."""
        if self._event.is_set():
            raise Stopped

    def wait(self, seconds: float) -> None:
        """Wait so long, or raise `Stopped` as soon as stopped."""
        if self._event.wait(seconds):
            raise Stopped

    def start(self, loop: Callable[[], None]) -> threading.Thread:
        """Run a loop in a new thread; its failure stops everything."""

        def run() -> None:
            try:
                loop()
            except Stopped:
                return
            except BaseException as error:  # the caller's thread raises it
                self.now(error)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        return thread


class WorkQueue(Generic[T]):
    """Items on their way from one thread to another, in order."""

    def __init__(self, stop: Stop) -> None:
        self._stop = stop
        self._items: deque[T] = deque()
        self._needed_items = 1
        self._changed = stop.condition()

    def put(self, item: T) -> None:
        """Add one item."""
        self._stop.check()
        with self._changed:
            self._items.append(item)
            # Waking a thread that waits for more items costs more than all else here.
            if len(self._items) >= self._needed_items:
                self._changed.notify()

    def take(self, at_most: int, timeout_s: float | None = None, *, at_least: int = 1) -> list[T]:
        """Wait for `at_least` so many items, and return them; on timeout return what is there.

        Only one thread at a time may wait for more than one item.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        with self._changed:
            self._needed_items = at_least
            while len(self._items) < at_least:
                self._stop.check()
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    break
                self._changed.wait(left)
            self._stop.check()
            return [self._items.popleft() for _ in range(min(at_most, len(self._items)))]


class Budget:
    """Bounds how much is under way at once. An amount larger than the limit may go alone.

    A thread that must wait waits until half is free, so that work comes in batches.
    """

    def __init__(self, stop: Stop, limit: int) -> None:
        self._stop = stop
        self._limit = limit
        self._used = 0
        self._changed = stop.condition()

    def acquire(self, amount: int) -> None:
        """Wait until there is room for `amount`, and take it."""
        with self._changed:
            room = self._limit
            while self._used > 0 and self._used + amount > room:
                room = self._limit // 2
                self._stop.check()
                self._changed.wait()
            self._stop.check()
            self._used += amount

    def used(self) -> int:
        """Return how much is under way."""
        with self._changed:
            return self._used

    def release(self, amount: int) -> None:
        """Give `amount` back."""
        with self._changed:
            self._used -= amount
            if self._used <= self._limit // 2:  # no thread could go on earlier
                self._changed.notify_all()

    def wait_until_free(self) -> None:
        """Wait until nothing is under way."""
        with self._changed:
            while self._used > 0:
                self._stop.check()
                self._changed.wait()
            self._stop.check()


def check_limits(connections: int, bytes_per_s: float | None) -> None:
    """Raise InvalidInput for limits with which nothing would ever move."""
    if connections < 1:
        raise InvalidInput(what=f"connections={connections}", reason="it must be at least 1")
    if bytes_per_s is not None and not bytes_per_s > 0:
        raise InvalidInput(what=f"bytes_per_s={bytes_per_s}", reason="it must be above zero")


class RateLimit:
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
