"""What all wardens do: the files by which they speak with a runner, the size of what a run wrote, words for its end.

Imports nothing but Python's own library, since runs wait for it.
"""

import contextlib
import json
import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path

WORK, USAGE, ENDING, LOG = "work.json", "usage.json", "ending.json", "log"
# Until when the runner holds the run, in seconds by `now_s`: without one, for as long as the run lasts.
HELD = "held"
STARTED = b"started\n"
NOTED = b"noted\n"
LOG_IS_FULL = b"\n[kleinkram] the log is full: what comes after this is not kept\n"
# An empty file takes room, too: of what a disk can name.
_ENTRY_BYTES = 1024
_RESERVED_BYTES = 4096
# Of the kernel's flags of a process: PF_EXITING.
_IS_ENDING = 4


def is_noted() -> bool:
    """Wait on stdin for the runner's word that it has written down who watches the run; False: it died before that.

    The next runner knows nothing of a warden that nobody wrote down, and starts the run anew in the same folder.
    """
    with os.fdopen(0, "rb", closefd=False) as words:
        return words.readline() == NOTED


def say_started() -> None:
    """Say on stdout that the run has begun; a runner that was killed does not hear it, and the next one finds it."""
    with contextlib.suppress(BrokenPipeError):
        os.write(1, STARTED)


def written_bytes(folder: Path) -> int:
    """Return what a run has written of the disk, to its `/out` and `/tmp`."""
    return sum(_size_of(folder / name) for name in ("out", "tmp"))


def _size_of(folder: Path) -> int:
    """What files below a folder take of the disk; links are not followed."""
    total = 0
    waiting = [str(folder)]
    while waiting:
        # What is gone by now takes nothing.
        with contextlib.suppress(OSError), os.scandir(waiting.pop()) as entries:
            for entry in entries:
                total += entry.stat(follow_symlinks=False).st_blocks * 512 + _ENTRY_BYTES
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
    return total


def is_held(folder: Path) -> bool:
    """Whether the runner still holds a run: a runner that is gone renews nothing, and another one gets its runs."""
    try:
        return now_s() < float((folder / HELD).read_text())
    except (FileNotFoundError, ValueError):
        return True


def now_s() -> float:
    """Return the time since this machine was started, sleep included."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if clock is None else time.clock_gettime(clock)


def told_by_code(code: int) -> tuple[str, str]:
    """Return reason and sentence for what a command said by its exit code, 128 + n where a signal ended it."""
    if code == 0:
        return "done", ""
    if code > 128 and code - 128 in {*signal.Signals}:
        return "signal", f"It was ended by the signal {signal.Signals(code - 128).name}."
    return "exit_code", f"It ended with the exit code {code}."


def too_much_memory(memory_bytes: int) -> tuple[str, str]:
    """Return reason and sentence for a run that used more memory than it may."""
    return "memory", f"It used more memory than its {_mb(memory_bytes)}."


def too_much_disk(disk_bytes: int) -> tuple[str, str]:
    """Return reason and sentence for a run that wrote more than it may."""
    return "disk", f"It wrote more than its {_mb(disk_bytes)} of disk."


def too_long(time_s: int) -> tuple[str, str]:
    """Return reason and sentence for a run that went on for longer than it may."""
    return "time", f"It ran for longer than its {time_s} s."


CANCELLED = ("cancelled", "It was cancelled.")
NO_ROOM = ("disk", "The disk of its runner is full. It can be run again once there is room.")
NOT_HELD = ("lost", "Its runner was not there for too long, so it was ended: another runner may have it.")


def _mb(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:,.0f} MB"


def write_whole(path: Path, facts: Mapping[str, object]) -> None:
    """Write a file whole, or not at all; what was reserved for it is used."""
    aside = _aside(path)
    with os.fdopen(os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600), "w") as stream:
        json.dump(facts, stream)
        stream.truncate()
        stream.flush()
        os.fsync(stream.fileno())
    aside.replace(path)


def reserve(path: Path) -> None:
    """Take the room for a file that is to be written whole later, though the disk be full by then.

    Raises:
        OSError: there is none.
    """
    with _aside(path).open("wb") as stream:
        stream.write(bytes(_RESERVED_BYTES))
        stream.flush()
        os.fsync(stream.fileno())


def _aside(path: Path) -> Path:
    return path.with_name(path.name + ".new")


def write_usage(folder: Path, use: Mapping[str, object]) -> None:
    """Write down what a run uses, where there is room for that: nothing depends on it."""
    with contextlib.suppress(OSError):
        write_whole(folder / USAGE, use)


def write_log(log: int, data: bytes) -> None:
    """Write all of what a run said.

    Raises:
        OSError: there is no room for it.
    """
    while data:
        data = data[os.write(log, data) :]


def began(pid: int) -> int | None:
    """When a process began, in ticks since the machine did; None where it is ending, or over though not reaped yet."""
    try:
        # The name, which stands in parentheses, may hold anything.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    # What ends has lost its memory, its namespaces and its control groups some time before it is said to be over.
    return None if fields[0] == "Z" or int(fields[6]) & _IS_ENDING else int(fields[19])
