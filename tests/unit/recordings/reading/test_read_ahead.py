"""Read-ahead in threads can be abandoned without waiting for a thread."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterator
from functools import partial

from kleinkram.recordings.sources import ReadAheadTask, read_ahead

_S = 20


class _Slow:
    """The first bytes are there at once, all others not before they are let through."""

    name = "slow"
    size_bytes = 8
    parallel_reads = 2

    def __init__(self) -> None:
        self.requested = threading.Event()
        self.let = threading.Event()

    def read(self, offset: int, length: int) -> bytes:
        if offset:
            self.requested.set()
            assert self.let.wait(_S)
        return bytes(length)


def _jobs(source: _Slow) -> Iterator[bytes]:
    jobs = (ReadAheadTask(1, partial(source.read, at, 1)) for at in (0, 0, 2, 3, 4))
    return read_ahead(jobs, workers=2, max_bytes=8)


def test_closing_waits_for_no_thread() -> None:
    """The garbage collector closes iterators wherever it runs, also where no thread can end (`threading`'s locks)."""
    source = _Slow()
    reading = _jobs(source)
    assert isinstance(reading, Generator)
    next(reading)
    next(reading)
    assert source.requested.wait(_S)

    closing = threading.Thread(target=reading.close, daemon=True)
    closing.start()
    closing.join(_S / 2)
    is_closed = not closing.is_alive()
    source.let.set()

    assert is_closed
    closing.join(_S)
    assert list(_jobs(source))  # a new iteration is complete


def test_the_first_tasks_run_at_once_where_all_are_wanted() -> None:
    together = threading.Barrier(4)
    tasks = iter([ReadAheadTask(1, partial(together.wait, _S))] * 4)

    assert sorted(read_ahead(tasks, workers=4, max_bytes=4, first_bytes=4)) == [0, 1, 2, 3]
