"""One running part: started, watched, started again after ever longer pauses, and its log kept within bounds."""

import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from kleinkram.standalone.child import end_group, stop

LOG_LIMIT_BYTES = 10 * 1024 * 1024
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.1, 30.0
_STEADY_S = 60.0
# Source: PostgreSQL, "Message Severity Levels"; what it says to clients while it starts, stops or has crashed.
_LAST_WORDS = ("PANIC:", "FATAL:")
_REFUSALS = ("the database system is", "terminating ")


@dataclass(frozen=True)
class Part:
    """What is to run, and how it is told to end."""

    name: str
    start: Callable[[], "subprocess.Popen[bytes]"]
    log: Path
    stop_signal: signal.Signals
    stop_timeout_s: float


@dataclass
class RunningPart:
    """A part with its process, if it has one now.

    `looked_at`: at how many failures its ports were looked at last. `log_from`: where its log begins, in bytes.
    """

    part: Part
    child: "subprocess.Popen[bytes]"
    started: float = field(default_factory=time.monotonic)
    failures: int = 0
    looked_at: int = 0
    start_again_at: float | None = None
    log_from: int = 0

    @property
    def pid(self) -> int | None:
        """The living process's pid."""
        return self.child.pid if self.start_again_at is None else None

    def ending(self) -> str | None:
        """How the process ended, in words; None while it lives."""
        code = self.child.poll()
        if code is None:
            return None
        return f"killed by signal {-code}" if code < 0 else f"exit code {code}"

    def schedule(self) -> float:
        """Plan the next start of a part that has ended; returns the pause in seconds."""
        end_group(self.child)
        now = time.monotonic()
        self.failures = 1 if now - self.started > _STEADY_S else self.failures + 1
        pause = min(_FIRST_PAUSE_S * 2.0 ** (self.failures - 1), _LONGEST_PAUSE_S)
        self.start_again_at = now + pause
        return pause

    def start_if_due(self) -> bool:
        """Start again if its time has come; returns whether it was started."""
        if self.start_again_at is None or time.monotonic() < self.start_again_at:
            return False
        self.log_from = _size_of(self.part.log)
        self.child = self.part.start()
        self.started = time.monotonic()
        self.start_again_at = None
        return True

    def stop(self) -> None:
        """End the process and its group."""
        stop(self.child, sign=self.part.stop_signal, timeout_s=self.part.stop_timeout_s)


def launch(part: Part) -> RunningPart:
    """Start a part for the first time."""
    log_from = _size_of(part.log)
    return RunningPart(part, part.start(), log_from=log_from)


def bound_log(log: Path, *, limit_bytes: int = LOG_LIMIT_BYTES) -> None:
    """Keep a log that a process appends to below the limit, with one older generation beside it.

    Copied, then emptied: the process goes on writing to the same file. Lines written in between are lost.
    """
    try:
        if log.stat().st_size <= limit_bytes:
            return
    except FileNotFoundError:
        return
    shutil.copyfile(log, log.with_suffix(".log.1"))
    with log.open("r+b") as file:
        file.truncate(0)


def last_complaint(log: Path, *, since: int = 0) -> str:
    """PostgreSQL's last word on why it could not go on, for a message; empty where there is none in the log's end.

    `since`: where in the log to begin, in bytes.
    """
    try:
        with log.open("rb") as file:
            size = log.stat().st_size
            file.seek(max(0, size - 16_384, since if since <= size else 0))
            lines = file.read().decode(errors="replace").splitlines()
    except FileNotFoundError:
        return ""
    said = [line.partition(word) for line in lines for word in _LAST_WORDS if word in line]
    # What it was asked meanwhile it refuses in the same tone.
    why = [rest.strip() for _, word, rest in said if not (word == "FATAL:" and rest.strip().startswith(_REFUSALS))]
    return why[-1][:300] if why else ""


def _size_of(log: Path) -> int:
    try:
        return log.stat().st_size
    except FileNotFoundError:
        return 0


def last_line(log: Path) -> str:
    """The last line that is not empty, for a message; at most 300 characters."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 4096))
            lines = [line.strip() for line in file.read().decode(errors="replace").splitlines() if line.strip()]
    except FileNotFoundError:
        return ""
    return lines[-1][:300] if lines else ""
