"""Run cases for a while: `python -m tests.fuzz --minutes 20 [--start N] [--cases N] [--real]`.

Bounds its own memory and each case's time. Exits 1 at the first case that breaks a promise, naming its number.
"""

from __future__ import annotations

import argparse
import faulthandler
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from tests.fuzz import seeds
from tests.fuzz.invariants import check
from tests.fuzz.mutations import mutated

_MEMORY_BYTES = 1536 * 2**20
_GROWTH_BYTES = 200 * 2**20
_CASE_S = 10
_STUCK_S = 60


def main() -> int:
    """Return 0 if every case kept the promises."""
    options = _arguments()
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    files = seeds.generated() + (seeds.real() if options.real else [])
    with tempfile.TemporaryDirectory() as folder:
        return _run(options, files, Path(folder))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--cases", type=int, default=10**12)
    parser.add_argument("--real", action="store_true")
    return parser.parse_args()


def _run(options: argparse.Namespace, files: list[seeds.Seed], folder: Path) -> int:
    ends = time.monotonic() + options.minutes * 60
    case, slowest_s = options.start, 0.0
    for seed in files:
        with _at_most(_CASE_S):
            check(seed, folder)
    before = _peak_bytes()
    while case < options.start + options.cases and time.monotonic() < ends:
        began = time.monotonic()
        try:
            with _at_most(_CASE_S):
                check(mutated(case, files), folder)
        except BaseException:
            sys.stderr.write(f"case {case} broke a promise (--start {case} --cases 1)\n")
            raise
        slowest_s = max(slowest_s, time.monotonic() - began)
        case += 1
    growth = _peak_bytes() - before
    cost = f"slowest {slowest_s:.2f} s, grown by {growth / 2**20:.0f} MB"
    sys.stdout.write(f"{case - options.start} cases of {len(files)} files, {cost}\n")
    return int(growth > _GROWTH_BYTES)


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@contextmanager
def _at_most(seconds: int) -> Iterator[None]:
    def too_long(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"longer than {seconds} s")

    signal.signal(signal.SIGALRM, too_long)
    signal.alarm(seconds)
    faulthandler.dump_traceback_later(_STUCK_S, exit=True)  # where no signal is heard: says where, and ends
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.alarm(0)


if __name__ == "__main__":
    sys.exit(main())
