"""The rows about a Slurm with nothing else to do: how soon a run begins, and how soon a cancelled one ends.

A real server, Slurm and runner, all on this machine.
"""

import functools
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tests import slurm_cluster
from tests.requirements import path_of
from tests.system.slurm_lab import Lab, lab

from kleinkram.contract.actions import ActionDefinition, Resources
from kleinkram.contract.runs import RunState

Row = dict[str, object]
_ROUNDS, _MOST_S, _POLL_S, _GIVE_UP_S = 10, 5.0, 0.05, 60.0
_SCRIPT = """
import time
print("begun", flush=True)
time.sleep(600)
"""


def slurm_rows(home: Path) -> Iterator[Row]:
    """Launch and cancel one run after the other; nothing where Slurm is not installed."""
    if not all(map(path_of, slurm_cluster.PROGRAMS)):
        return
    resources = Resources(cores=1, memory_bytes=200_000_000, disk_bytes=50_000_000, time_s=900)
    action = ActionDefinition(name="wait", script=_SCRIPT, resources=resources)
    begun: list[float] = []
    shown: list[float] = []
    cancelled: list[float] = []
    home.mkdir()
    with lab(home) as slurm:
        for _ in range(_ROUNDS + 1):
            run_id, *others = slurm.launch(action, missions=1)
            assert not others
            launched_s = time.monotonic()
            begun.append(_seconds_until(launched_s, functools.partial(_is_running, slurm, run_id)))
            shown.append(_seconds_until(launched_s, functools.partial(_has_log, slurm, run_id)))
            cancelled_s = time.monotonic()
            slurm.client.runs.cancel(run_id)
            cancelled.append(_seconds_until(cancelled_s, lambda: slurm.active() == 0))
    # The first one finds the image and measures the node.
    yield _row("queued to running on an idle Slurm", begun[1:], f"; its first output after {_summary(shown[1:])}")
    yield _row("a cancelled run on Slurm until its end", cancelled[1:], "")


def _is_running(slurm: Lab, run_id: str) -> bool:
    return slurm.client.runs.get(run_id).state is RunState.running


def _has_log(slurm: Lab, run_id: str) -> bool:
    return any(piece.text for piece in slurm.client.runs.log(run_id))


def _seconds_until(since_s: float, is_met: Callable[[], bool]) -> float:
    while not is_met():
        if time.monotonic() - since_s > _GIVE_UP_S:
            raise SystemExit("Slurm is not idle, or a run does not start")
        time.sleep(_POLL_S)
    return time.monotonic() - since_s


def _summary(seconds: list[float]) -> str:
    return f"{statistics.median(seconds):.1f} s (median), at most {max(seconds):.1f} s"


def _row(what: str, seconds: list[float], also: str) -> Row:
    return {
        "what": f"{what}, {len(seconds)} times",
        "measured": _summary(seconds) + also,
        "bar": f"<= {_MOST_S:.0f} s",
        "met": max(seconds) <= _MOST_S,
        "seconds": seconds,
    }
