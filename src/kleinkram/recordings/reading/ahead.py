"""Doing the next jobs while the last one is being used, in order and in bounded memory.

How far ahead depends on what is asked for: the first job is done alone, so whoever wants one frame pays for one
chunk; with each that follows, twice as many bytes may be under way, up to a bound.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, NamedTuple, TypeVar

from kleinkram.recordings.memory import keep_freed_memory

T = TypeVar("T")


class Job(NamedTuple, Generic[T]):
    """Something to do, and the bytes that it will hold."""

    size_bytes: int
    run: Callable[[], T]


def do_ahead(jobs: Iterator[Job[T]], *, workers: int, most_bytes: int) -> Iterator[T]:
    """Yield what the jobs return, in order; one that raises raises here, in its turn.

    Closed early, it returns at once: jobs that have begun go on to their end, and nobody hears of them.
    """
    first = next(jobs, None)
    if first is None:
        return
    keep_freed_memory()
    yield first.run()
    pool = ThreadPoolExecutor(workers, thread_name_prefix="read-ahead")
    try:
        under_way: deque[tuple[int, Future[T]]] = deque()
        allowance, held = max(1, first.size_bytes), 0
        upcoming = next(jobs, None)
        while upcoming is not None or under_way:
            allowance = min(most_bytes, 2 * allowance)
            while upcoming is not None and (not under_way or held + upcoming.size_bytes <= allowance):
                under_way.append((upcoming.size_bytes, pool.submit(upcoming.run)))
                held += upcoming.size_bytes
                upcoming = next(jobs, None)
            size, future = under_way.popleft()
            result = future.result()
            held -= size
            yield result
    finally:
        # Nobody waits for the threads here: the garbage collector may close this, in a thread that is being started,
        # and no thread could end then.
        pool.shutdown(wait=False, cancel_futures=True)
