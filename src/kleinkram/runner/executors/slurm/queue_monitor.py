"""One thread that asks Slurm about all jobs of a runner at once, and sends what is to be cancelled in bulk.

The accounting is asked about all ended jobs at once, too, as often as the queue is.
"""

import logging
import threading
import time
from dataclasses import dataclass, field

from kleinkram.runner.executors.slurm.commands import (
    JobAccount,
    QueueEntry,
    SlurmCommands,
    SlurmRefused,
    SlurmUnavailable,
)
from kleinkram.runner.executors.slurm.states import Phase, phase_of
from kleinkram.runner.executors.supervision import boot_time_s

_log = logging.getLogger("kleinkram.runner")
_EVERY_S = 1.0
# Slurm is busy: ask for at most this share of the time.
_BUSY_SHARE = 0.25
_MAX_PAUSE_S = 30.0
_DOWN_S = 2.0


@dataclass(frozen=True)
class QueueSnapshot:
    """The jobs in Slurm's queue as of `queried_s` (of `boot_time_s`), by their names."""

    queried_s: float = 0.0
    entries: dict[str, QueueEntry] = field(default_factory=dict)


class QueueMonitor:
    """Watches the jobs whose names begin with a prefix. Thread-safe. Asks nothing while nothing is watched."""

    def __init__(self, commands: SlurmCommands, prefix: str) -> None:
        self._commands = commands
        self._prefix = prefix
        self.snapshot = QueueSnapshot()
        # Why Slurm did not answer last, if so.
        self.error: str | None = None
        self._watched: set[str] = set()
        self._stop: set[str] = set()
        self._kill: set[str] = set()
        self._release: set[str] = set()
        self._unaccounted: dict[str, str] = {}
        self._accounts: dict[str, JobAccount] = {}
        self._kills_others = False
        self._lock = threading.Lock()
        self._has_work = threading.Event()
        self._has_answer = threading.Condition()
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def watch(self, name: str) -> None:
        """Watch a job."""
        with self._lock:
            self._watched.add(name)
        self._wake()

    def forget(self, name: str) -> None:
        """Watch a job no longer."""
        with self._lock:
            for names in (self._watched, self._stop, self._release):
                names.discard(name)
            self._unaccounted.pop(name, None)
            self._accounts.pop(name, None)

    def stop(self, name: str) -> None:
        """Cancel a job that waits; have one that runs end itself."""
        with self._lock:
            self._stop.add(name)
        self._wake()

    def kill(self, name: str) -> None:
        """End a job at once, once Slurm answers; it is no longer watched then."""
        with self._lock:
            self._kill.add(name)
        self._wake()

    def release(self, name: str) -> None:
        """Release a job that Slurm holds."""
        with self._lock:
            self._release.add(name)
        self._wake()

    def account(self, name: str, job_id: str) -> JobAccount | None:
        """Return what the accounting has about an ended job; None where it was not asked yet, or has nothing yet."""
        with self._lock:
            if (account := self._accounts.get(name)) is not None:
                return account
            self._unaccounted[name] = job_id
        self._wake()
        return None

    def kill_others(self) -> None:
        """End the jobs of an earlier runner process that are not watched, once Slurm answers."""
        with self._lock:
            self._kills_others = True
        self._wake()

    def wait_until_gone(self, name: str, timeout_s: float) -> bool:
        """Wait until a job has ended, or is unknown to Slurm; return whether that is so. Soon where Slurm is down."""
        queried_s = boot_time_s()
        with self._has_answer:
            while not self._is_gone(name, queried_s):
                self._wake()
                waited_s = boot_time_s() - queried_s
                if waited_s >= timeout_s or (self.error is not None and waited_s >= _DOWN_S):
                    return False
                self._has_answer.wait(0.2)
        return True

    def _is_gone(self, name: str, since_s: float) -> bool:
        snapshot = self.snapshot
        entry = snapshot.entries.get(name)
        is_over = entry is None or (phase_of(entry.state) is Phase.ended)
        return snapshot.queried_s > since_s and is_over and name not in self._kill

    def _wake(self) -> None:
        self._has_work.set()
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="slurm", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._is_closed = True
        self._has_work.set()

    def _run(self) -> None:
        while True:
            self._has_work.wait()
            self._has_work.clear()
            if self._is_closed:
                return
            queried_s = time.monotonic()
            self._ask()
            took_s = time.monotonic() - queried_s
            with self._has_answer:
                self._has_answer.notify_all()
            if self._is_needed():
                self._has_work.set()
                self._pause(min(_MAX_PAUSE_S, max(_EVERY_S, took_s / _BUSY_SHARE)))

    def _is_needed(self) -> bool:
        with self._lock:
            return bool(self._watched or self._kill or self._kills_others or self._unaccounted)

    def _pause(self, seconds: float) -> None:
        """Wait, but not where something is to be cancelled."""
        until_s = time.monotonic() + seconds
        while (remaining_s := until_s - time.monotonic()) > 0:
            with self._lock:
                is_urgent = bool(self._stop or self._kill) and self.error is None
            if is_urgent:
                return
            time.sleep(min(0.1, remaining_s))

    def _ask(self) -> None:
        try:
            queried_s = boot_time_s()
            entries = self._commands.own_jobs(self._prefix)
            self.snapshot = QueueSnapshot(queried_s, {entry.name: entry for entry in entries})
            self._act(self.snapshot.entries)
            if self.error is not None:
                _log.info("Slurm answers again")
            self.error = None
        except (SlurmUnavailable, SlurmRefused, OSError) as error:
            if self.error is None:
                _log.warning("Slurm does not answer: %s", error)
            self.error = str(error)
        else:
            self._ask_accounts()

    def _ask_accounts(self) -> None:
        with self._lock:
            names = dict(self._unaccounted)
        if not names:
            return
        try:
            accounts = self._commands.accounts(sorted({*names.values()}))
        except (SlurmUnavailable, SlurmRefused):  # it is asked again
            return
        with self._lock:
            for name, job_id in names.items():
                account = accounts.get(job_id)
                # Slurm may use an id twice.
                is_its = account is not None and account.name == name and phase_of(account.state) is Phase.ended
                if account is not None and is_its and name in self._unaccounted:
                    del self._unaccounted[name]
                    self._accounts[name] = account

    def _act(self, entries: dict[str, QueueEntry]) -> None:
        self._find_others(entries)
        with self._lock:
            stop, kill, release = set(self._stop), set(self._kill), set(self._release)
        if ids := _ids(entries, stop, Phase.waiting):
            self._commands.cancel_waiting(ids)
        if ids := _ids(entries, stop, Phase.waiting, Phase.running):
            self._commands.terminate(ids)
        if ids := _ids(entries, kill, Phase.waiting, Phase.running):
            self._commands.kill(ids)
        for job_id in _ids(entries, release, Phase.waiting):
            self._commands.release(job_id)
        with self._lock:
            # One that is not in the queue yet is found later.
            self._stop -= stop & entries.keys()
            self._release -= release
            self._kill -= kill
            self._watched -= kill

    def _find_others(self, entries: dict[str, QueueEntry]) -> None:
        with self._lock:
            if self._kills_others:
                self._kills_others = False
                self._kill |= entries.keys() - self._watched


def _ids(entries: dict[str, QueueEntry], names: set[str], *phases: Phase) -> list[str]:
    matching = [entries[name] for name in sorted(names) if name in entries]
    return [entry.job_id for entry in matching if phase_of(entry.state) in phases]
