"""The threads of an upload or a download, and their limits: queues, budgets, a rate limit and a congestion window.

`TransferPool` moves the parts of files over several connections and retries them. The failure of one file ends that
file; any other failure stops all threads, and the caller's thread raises it.
"""

import contextlib
import contextvars
import itertools
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

from kleinkram.client import errors
from kleinkram.client._http import Backoff, store_unreachable
from kleinkram.client._network import NetworkMonitor
from kleinkram.client.transfer import store
from kleinkram.client.transfer.report import LinkReport, OutageReporter, TransferResult, Watcher, diagnose
from kleinkram.client.transfer.store import StoreAnswer, StoreClient, StoreResult
from kleinkram.contract.errors import FileUnavailable, KleinkramError, NotFound, UploadGone
from kleinkram.contract.uploads import MIN_PART_BYTES

# A part that takes less time adds room for another; one that takes more halves the window.
QUICK_S, SLOW_S = 5.0, 15.0
# After a lost connection, and on a link that is neither quick nor slow, the window grows again after this time.
CALM_S = 60.0
QUICK_AFTER_LOSS_S = 1.0
_RECONNECT_S = 0.05
_REFUSALS = 4
# After so many files in a row that the store refused until the retry timeout, the store itself is in trouble.
_MAX_FAILED_FILES = 3
_JOIN_S = 2.0
_FILE_ERRORS = (
    errors.DestinationDiffers,
    errors.DestinationRefused,
    errors.FileChanged,
    FileUnavailable,
    errors.FileUnreadable,
    NotFound,
    errors.TransferFailed,
    UploadGone,
    errors.VerifyFailed,
)

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
        """Wait, or raise `Stopped` as soon as stopped."""
        if self._event.wait(seconds):
            raise Stopped

    def start(self, loop: Callable[[], None]) -> threading.Thread:
        """Run a loop in a new thread, as part of the caller's trace; its failure stops everything."""

        def run() -> None:
            try:
                loop()
            except Stopped:
                return
            except BaseException as error:  # the caller's thread raises it
                self.now(error)

        thread = threading.Thread(target=contextvars.copy_context().run, args=(run,), daemon=True)
        thread.start()
        return thread


class WorkQueue(Generic[T]):
    """A queue of items between threads, in order."""

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
        """Wait for `at_least` items and return at most `at_most`; on timeout, return those that are there.

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
    """Bounds an amount in use. An amount larger than the limit is admitted alone.

    A thread that must wait waits until half is free, so that work comes in batches.
    """

    def __init__(self, stop: Stop, limit: int) -> None:
        self._stop = stop
        self._limit = limit
        self._used = 0
        self._changed = stop.condition()

    def acquire(self, amount: int) -> None:
        """Wait until `amount` is free, and take it."""
        with self._changed:
            room = self._limit
            while self._used > 0 and self._used + amount > room:
                room = self._limit // 2
                self._stop.check()
                self._changed.wait()
            self._stop.check()
            self._used += amount

    def used(self) -> int:
        """Return the amount in use."""
        with self._changed:
            return self._used

    def release(self, amount: int) -> None:
        """Give `amount` back."""
        with self._changed:
            self._used -= amount
            if self._used <= self._limit // 2:  # no thread could go on earlier
                self._changed.notify_all()

    def wait_until_free(self) -> None:
        """Wait until nothing is in use."""
        with self._changed:
            while self._used > 0:
                self._stop.check()
                self._changed.wait()
            self._stop.check()


class RateLimit:
    """A token bucket that holds the bytes of at most a quarter of a second. Safe to share between threads."""

    def __init__(self, bytes_per_s: float | None, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = bytes_per_s
        self._clock = clock
        self._lock = threading.Lock()
        self._free_at = clock()

    def spend(self, size_bytes: int, wait: Callable[[float], object]) -> None:
        """Take the allowance for some bytes; calls `wait` (seconds) if it is used up."""
        if self._rate is None:
            return
        with self._lock:
            now = self._clock()
            begins = max(self._free_at, now - 0.25)
            self._free_at = begins + size_bytes / self._rate
            delay_s = self._free_at - now
        if delay_s > 0:
            wait(delay_s)


class CongestionWindow:
    """Bounds the bytes in flight, adapts that limit to the link, and admits parts in order. Safe to share.

    It begins with one part. A part that arrives quickly adds its size, up to `connections` parts. A lost connection, or
    parts that take long, leave one part. On a link in between, one is added after a calm minute: several connections
    may be faster than one where each is limited by itself.

    An interrupted part continues before others begin, so that a bad link does not carry only beginnings of parts. One
    part is always admitted.
    """

    def __init__(self, connections: int, stop: Stop, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._connections = connections
        self._stop = stop
        self._clock = clock
        self._calm_since = self.arrived_at = clock()
        self._has_lost = False
        self.limit_bytes = MIN_PART_BYTES
        self._in_flight_bytes = 0
        self._in_flight: set[int] = set()
        self._numbers = itertools.count()
        self._queue: list[int] = []
        self._changed = stop.condition()

    @contextlib.contextmanager
    def slot(self) -> Iterator[int]:
        """Enter a part into the queue until it has moved; yields its slot."""
        with self._changed:
            slot = next(self._numbers)
            self._queue.append(slot)
        try:
            yield slot
        finally:
            self.leave(slot)

    def leave(self, slot: int) -> None:
        """Leave the queue, for a failure that concerns this part alone; the next `acquire` enters it at the end."""
        with self._changed:
            if slot in self._queue:
                self._queue.remove(slot)
            self._changed.notify_all()

    @contextlib.contextmanager
    def acquire(self, slot: int, size_bytes: int) -> Iterator[float]:
        """Wait until the window admits a part, and count it as in flight; yields the seconds waited."""
        began_at = time.monotonic()
        with self._changed:
            if slot not in self._queue:
                self._queue.append(slot)
            while not self._is_admitted(slot, size_bytes):
                self._stop.check()
                self._changed.wait()
            self._stop.check()
            self._in_flight_bytes += size_bytes
            self._in_flight.add(slot)
            self._changed.notify_all()
        try:
            yield time.monotonic() - began_at
        finally:
            with self._changed:
                self._in_flight_bytes -= size_bytes
                self._in_flight.remove(slot)
                self._changed.notify_all()

    def _is_admitted(self, slot: int, size_bytes: int) -> bool:
        if any(earlier not in self._in_flight for earlier in self._queue[: self._queue.index(slot)]):
            return False
        return self._in_flight_bytes == 0 or self._in_flight_bytes + size_bytes <= self.limit_bytes

    def arrived(self, size_bytes: int, took_s: float) -> None:
        """Adapt to a part that arrived."""
        unit_bytes = max(size_bytes, MIN_PART_BYTES)
        took_s *= MIN_PART_BYTES / unit_bytes
        with self._changed:
            self.arrived_at = now = self._clock()
            is_calm = now - self._calm_since >= CALM_S
            self._has_lost = self._has_lost and not is_calm
            is_quick = took_s <= (QUICK_AFTER_LOSS_S if self._has_lost else QUICK_S)
            if took_s > SLOW_S:
                self.limit_bytes = max(MIN_PART_BYTES, self.limit_bytes // 2)
                self._calm_since = now
            elif is_quick or is_calm:
                most_bytes = self._connections * unit_bytes
                self.limit_bytes = max(self.limit_bytes, min(self.limit_bytes + size_bytes, most_bytes))
                if not is_quick:
                    self._calm_since = now

    def lost(self) -> None:
        """Adapt to a connection that broke, or to a store that asks for less."""
        with self._changed:
            self.limit_bytes = MIN_PART_BYTES
            self._calm_since = self._clock()
            self._has_lost = True


class FileTransfer(ABC):
    """A file under way: counts its parts, and ends once. Safe to share between threads. `url`: where its bytes are."""

    def __init__(self, path: str, url: str = "") -> None:
        self.path = path
        self.url = url
        self.ended = False
        self._lock = threading.Lock()
        self._open_parts = 1  # queueing the parts counts as one

    def add_part(self) -> None:
        """Count one more part to move."""
        with self._lock:
            self._open_parts += 1

    def part_done(self) -> bool:
        """Count one part (or the queueing) as done; return True for the last."""
        with self._lock:
            self._open_parts -= 1
            return self._open_parts == 0

    def end(self) -> bool:
        """End this file; return False when it had ended already."""
        with self._lock:
            first, self.ended = not self.ended, True
        return first

    @abstractmethod
    def close(self) -> None:
        """Close what is open; the next run can resume the file."""


@dataclass
class Part:
    """A part of a file. `cost` counts against the limit of what is queued; `moved_bytes` need not move again."""

    file: FileTransfer
    number: int
    offset: int
    size_bytes: int
    cost: int = 1
    moved_bytes: int = 0

    @property
    def left_bytes(self) -> int:
        """The bytes that must still move."""
        return self.size_bytes - self.moved_bytes


PartT = TypeVar("PartT", bound=Part)


class TransferPool(ABC, Generic[PartT]):
    """The threads of one upload or download: they move queued parts until the store has taken or given each.

    `spare_threads`: threads beyond the connections, for work on parts that have moved.
    """

    def __init__(
        self,
        server_url: str,
        *,
        connections: int,
        spare_threads: int,
        max_files: int,
        max_queued: int,
        bytes_per_s: float | None,
        watcher: Watcher,
    ) -> None:
        if connections < 1:
            raise errors.InvalidInput(what=f"connections={connections}", reason="it must be at least 1")
        if bytes_per_s is not None and not bytes_per_s > 0:
            raise errors.InvalidInput(what=f"bytes_per_s={bytes_per_s}", reason="it must be above zero")
        self.stop = Stop()
        self.outages = OutageReporter(watcher.notify)
        self.results: list[TransferResult] = []
        self._server_url = server_url
        self._watcher = watcher
        self._rate_limit = RateLimit(bytes_per_s)
        self._store = StoreClient(connections)
        self._window = CongestionWindow(connections, self.stop)
        self._connections = threading.BoundedSemaphore(connections)
        self._loops: list[Callable[[], None]] = [self._move_parts] * (connections + spare_threads)
        self._files = Budget(self.stop, max_files)
        self._queued = Budget(self.stop, max_queued)
        self._parts: WorkQueue[PartT] = WorkQueue(self.stop)
        self._open: set[FileTransfer] = set()
        self._failed_files = 0

    def run(self, work: Callable[[], None]) -> LinkReport:
        """Run `work`, which queues the parts of files, until all files have ended; return how the network was.

        Raises:
            KleinkramError: something that concerns all files; the next run resumes.
        """
        threads = [self.stop.start(loop) for loop in self._loops]
        failure: BaseException | None = None
        try:
            with NetworkMonitor(self.outages.network_changed), contextlib.suppress(Stopped):
                work()
                self._files.wait_until_free()
        except KleinkramError as error:
            failure = error
        finally:
            self.stop.now()
            deadline = time.monotonic() + _JOIN_S  # shared: on a dead link, every thread would use all of it
            for thread in threads:
                thread.join(max(0.0, deadline - time.monotonic()))
            for file in [*self._open]:
                file.close()
            self._store.close()
        failure = failure or self.stop.failure
        if failure is None:
            return self.outages.report()
        if isinstance(failure, errors.ServerUnreachable | errors.StoreUnreachable):
            self._watcher.notify(diagnose(self._server_url, self.outages.store_url))
        if (advice := self.outages.report().advice()) is not None:
            self._watcher.notify(advice)
        raise failure

    def add_result(self, result: TransferResult) -> None:
        """Add the result for a file, and pass it to the watcher."""
        self.results.append(result)
        self._watcher.ended(result.path, result.outcome.value, str(result.error) if result.error else None)

    def wait_for_server(self, seconds: float) -> None:
        """Wait before a request to the server is tried again, and report that it does not answer."""
        self.outages.server_unavailable(self._server_url)
        self.stop.wait(seconds)

    def _open_file(self, file: FileTransfer) -> None:
        """Count a file as under way; waits while there are too many."""
        self._open.add(file)
        self._files.acquire(1)

    def _add_part(self, part: PartT) -> None:
        """Count a part as queued; waits while there are too many."""
        self._queued.acquire(part.cost)
        part.file.add_part()

    def _close_file(self, file: FileTransfer) -> None:
        """Close a file; only once no thread uses it any more."""
        self._open.discard(file)
        file.close()
        self._files.release(1)

    def _move_parts(self) -> None:
        while True:
            for part in self._parts.take(1):
                try:
                    if not part.file.ended:
                        with self._connections:
                            self._move(part)
                        self._moved(part)
                except _FILE_ERRORS as error:
                    self._part_failed(part, error)
                self._part_done(part)

    def _move(self, part: PartT) -> None:
        """Request a part until all of it has moved; raise the error that ends its file."""
        backoff: Backoff | None = None  # begins at the first failure: a part may be in flight for long
        began_at, refusals = time.monotonic(), 0
        with self._window.slot() as slot:
            while True:
                left_bytes = part.left_bytes
                with self._window.acquire(slot, left_bytes) as waited_s:
                    if backoff is not None:
                        backoff.extend(waited_s)
                    requested_at = time.monotonic()
                    result = self._request(part)
                    took_s = time.monotonic() - requested_at
                    if result is None:
                        self._window.arrived(left_bytes, took_s)
                        self.outages.arrived(took_s)
                        self._failed_files = 0
                        return
                    if result.is_store_wide:
                        self._window.lost()
                has_progress = part.left_bytes < left_bytes
                if result.answer in {StoreAnswer.taken, StoreAnswer.try_again}:
                    # If other parts arrived since, the link works.
                    if backoff is None or has_progress or self._window.arrived_at > began_at:
                        backoff, began_at = Backoff(store.TRANSFER_RETRY_S, self.stop.wait), time.monotonic()
                    self._report_failure(part, result, backoff)
                    if has_progress:
                        continue
                    if result.error is None:
                        self._window.leave(slot)
                    if not self._pause(backoff):
                        raise self._give_up(part, result)
                    if result.error is not None:
                        continue  # the signature is still good
                else:
                    refusals += 1
                    self._check_source(part)
                    if result.answer is StoreAnswer.gone or refusals >= _REFUSALS:
                        raise errors.TransferFailed(path=part.file.path, reason=result.reason)
                self._sign_again(part)

    def _pause(self, backoff: Backoff) -> bool:
        """Wait before the next try, briefly if the network changed; return False after the retry timeout."""
        if not self.outages.is_network_changed():
            return backoff.pause()
        self.stop.wait(_RECONNECT_S)
        return True

    def _give_up(self, part: PartT, result: StoreResult) -> KleinkramError:
        """Return the error for a part that the store refused until the retry timeout."""
        self._failed_files += 1
        if result.is_store_wide or self._failed_files > _MAX_FAILED_FILES:
            return store_unreachable(part.file.url, result.why)
        return errors.StoreRetriesExhausted(path=part.file.path, reason=result.why)

    def _report_failure(self, part: PartT, result: StoreResult, backoff: Backoff) -> None:
        self.outages.lost(part.file.url, backoff, result.error, result.why, result.sent_bytes)

    def _check_source(self, part: PartT) -> None:
        """Raise an error if the store refused the part because the file on this machine changed."""

    @abstractmethod
    def _request(self, part: PartT) -> StoreResult | None:
        """Move what is left of a part; return None once all of it has moved, else why not."""

    @abstractmethod
    def _sign_again(self, part: PartT) -> None:
        """Get a new URL for a part."""

    @abstractmethod
    def _moved(self, part: PartT) -> None:
        """Process a part that has moved."""

    @abstractmethod
    def _part_failed(self, part: PartT, error: KleinkramError) -> None:
        """End the file of a part."""

    @abstractmethod
    def _part_done(self, part: PartT) -> None:
        """Take a part out of the counts, whether it moved or not."""
