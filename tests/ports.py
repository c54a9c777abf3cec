"""Ports for services of tests: each worker has its own range, outside the default ports."""

import itertools
import os
import random

from kleinkram.standalone.address import is_free

_FIRST, _COUNT, _WORKERS = 10_000, 2_000, 5
# Those that are no worker's are of a session of its own: it begins anywhere, for there may be another one.
_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", f"gw{_WORKERS - 1}").removeprefix("gw")) % _WORKERS
_numbers = itertools.count(random.randrange(_COUNT))


def choose_port() -> int:
    """A free loopback port, and each time another one."""
    of_worker = (_FIRST + _WORKER * _COUNT + number % _COUNT for number in _numbers)
    return next(port for port in of_worker if is_free(port))
