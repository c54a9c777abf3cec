"""Ending processes that an earlier supervisor of this data directory left, and the supervisor itself on request.

A process is signalled only through a pidfd that was opened before its identity was checked: never a recycled pid.
"""

import contextlib
import json
import os
import select
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass

from kleinkram.standalone.data_dir import DataDir, is_held, read_holder
from kleinkram.standalone.errors import NotRunning, PartFailed
from kleinkram.standalone.procs import marked_processes, start_ticks

_GRACE_S = 5.0


@dataclass(frozen=True)
class Ended:
    """An instance that runs no more: its supervisor's pid, and its parts' by name."""

    pid: int
    parts: dict[str, int]


def end_leftovers(data_dir: DataDir) -> int:
    """End every process marked with this data directory; returns how many there were. The caller holds the lock.

    Raises:
        PartFailed: one of them does not end.
    """
    found = marked_processes(data_dir.root)
    # SIGINT lets PostgreSQL close its files; what does not heed it within the grace is killed, and recovers.
    for sign in (signal.SIGINT, signal.SIGKILL):
        for pid in marked_processes(data_dir.root):
            _signal_marked(pid, sign, data_dir)
        deadline = time.monotonic() + _GRACE_S
        while marked_processes(data_dir.root) and time.monotonic() < deadline:
            time.sleep(0.02)
    stubborn = marked_processes(data_dir.root)
    if stubborn:
        raise PartFailed(
            f"Processes {', '.join(map(str, stubborn))} of an earlier start on {data_dir.root} do not end: "
            "restart the machine, or name another --data-dir."
        )
    return len(found)


def stop_instance(data_dir: DataDir, *, timeout_s: float = 60) -> Ended:
    """Ask the supervisor of this data directory to stop all parts, and wait until it is gone; returns what ended.

    Raises:
        NotRunning: nothing runs there.
        PartFailed: it does not end in time.
    """
    holder = read_holder(data_dir)
    if holder is None or not is_held(data_dir):
        raise NotRunning(f"Kleinkram does not run on {data_dir.root}: there is nothing to end.")
    ended = Ended(holder.pid, _living_parts(data_dir, holder.pid))
    with _pidfd(holder.pid) as descriptor:
        if descriptor is None or start_ticks(holder.pid) != holder.start_ticks:
            return ended
        signal.pidfd_send_signal(descriptor, signal.SIGTERM)
        waiting = select.poll()
        waiting.register(descriptor, select.POLLIN)
        if not waiting.poll(timeout_s * 1000):
            raise PartFailed(
                f"Kleinkram on {data_dir.root} (pid {holder.pid}) has not ended within {timeout_s:.0f} s: "
                f"see {data_dir.root / 'logs'}; `kill -9 {holder.pid}` is safe, the next `klein up` recovers."
            )
    return ended


def _living_parts(data_dir: DataDir, pid: int) -> dict[str, int]:
    """The parts by name, as the instance of this supervisor tells; none while it is still starting."""
    try:
        told = json.loads(data_dir.instance_file.read_text())
    except FileNotFoundError:
        return {}
    # One that was killed leaves its own, which the next replaces only once it has started.
    return {name: part for name, part in told["parts"].items() if part is not None and told["pid"] == pid}


@contextlib.contextmanager
def _pidfd(pid: int) -> Iterator[int | None]:
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        yield None
        return
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _signal_marked(pid: int, sign: signal.Signals, data_dir: DataDir) -> None:
    with _pidfd(pid) as descriptor:
        if descriptor is not None and pid in marked_processes(data_dir.root):
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(descriptor, sign)
