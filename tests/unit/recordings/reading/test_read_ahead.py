"""Read-ahead in threads can be abandoned without waiting for a thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterator
from functools import partial

import pytest

from kleinkram.recordings.merge import ReadAheadTask, read_ahead
from kleinkram.recordings.sources import read_ranges

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
    return read_ahead(jobs, workers=2, most_bytes=8)


def _ranges(source: _Slow) -> Iterator[bytes]:
    return read_ranges(source, [(at, 1) for at in (0, 2, 3, 4)])


@pytest.mark.parametrize("begin", [_jobs, _ranges])
def test_closing_waits_for_no_thread(begin: Callable[[_Slow], Iterator[bytes]]) -> None:
    """The garbage collector closes iterators wherever it runs, also where no thread can end (`threading`'s locks)."""
    source = _Slow()
    reading = begin(source)
    assert isinstance(reading, Generator)
    next(reading)
    if begin is _jobs:
        next(reading)
    assert source.requested.wait(_S)

    closing = threading.Thread(target=reading.close, daemon=True)
    closing.start()
    closing.join(_S / 2)
    is_closed = not closing.is_alive()
    source.let.set()

    assert is_closed
    closing.join(_S)
    assert list(begin(source))  # a new iteration is whole
