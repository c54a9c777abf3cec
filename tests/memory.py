"""Peaks of allocated memory."""

import tracemalloc
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
_ATTEMPTS = 5


def call_within(peak_bytes: int, function: Callable[[], T]) -> T:
    """The function's result; it fails if the function's allocations exceed `peak_bytes`.

    Allocations of other threads of the process count too, such as those of servers that other tests
    started. The function is therefore called several times until it stays within the limit.
    """
    for _ in range(_ATTEMPTS):
        tracemalloc.start()
        try:
            result = function()
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        if peak < peak_bytes:
            return result
    raise AssertionError(f"Allocates {peak:,} bytes, more than {peak_bytes:,}.")
