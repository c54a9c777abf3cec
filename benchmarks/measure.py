"""Runs one side of a comparison as a process, and compares two sides in alternating runs."""

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

PAIRS = int(os.environ.get("KLEINKRAM_BENCH_PAIRS", "6"))


@dataclass(frozen=True)
class Run:
    """One run of one side. `seconds` is what the side itself measured; the rest is measured of the process."""

    seconds: float
    cpu_s: float
    peak_mb: float
    facts: dict[str, float]


def run_side(name: str, *arguments: str, environment: dict[str, str], module: str = "benchmarks.sides") -> Run:
    """Run `python -m MODULE NAME ARGUMENTS…` and return its measurement."""
    command = [sys.executable, "-m", module, name, *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ, **environment})
    stdout = process.stdout.read() if process.stdout else b""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"the side {name} failed with exit code {process.returncode}")
    facts: dict[str, float] = json.loads(stdout)
    cpu_s = usage.ru_utime + usage.ru_stime - facts.pop("import_cpu_s", 0.0)
    return Run(facts.pop("seconds"), cpu_s, usage.ru_maxrss / 1024, facts)


@dataclass(frozen=True)
class Pairing:
    """Two sides after all their runs: `ratio` is the median over pairs of (raw seconds / our seconds)."""

    ours: list[Run]
    raw: list[Run]
    ratio: float

    def median(self, of: Callable[[Run], float]) -> float:
        """Return the median of one figure over our runs."""
        return statistics.median(of(run) for run in self.ours)


def pair(ours: Callable[[], Run], raw: Callable[[], Run], *, pairs: int = PAIRS) -> Pairing:
    """Run both sides in turn, each as often first as second."""
    our_runs, raw_runs = [], []
    for number in range(pairs):
        if number % 2 == 0:
            our_runs.append(ours())
            raw_runs.append(raw())
        else:
            raw_runs.append(raw())
            our_runs.append(ours())
    ratios = [theirs.seconds / our.seconds for our, theirs in zip(our_runs, raw_runs, strict=True)]
    return Pairing(our_runs, raw_runs, statistics.median(ratios))


def take_turns(names: Sequence[str], *arguments: str, module: str, rounds: int) -> dict[str, list[Run]]:
    """Run all sides equally often, in rotating order."""
    runs: dict[str, list[Run]] = {name: [] for name in names}
    for number in range(rounds):
        shift = number % len(names)
        for name in (*names[shift:], *names[:shift]):
            runs[name].append(run_side(name, *arguments, environment={}, module=module))
    return runs
