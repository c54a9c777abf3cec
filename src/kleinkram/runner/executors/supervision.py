"""What the runner and the supervisors of processes share: the limits of jobs, the sentences for endings, and files.

The files are complete after a kill at any moment. Imports only the standard library: supervisors start faster.
"""

import contextlib
import os
import signal
import time
from pathlib import Path
from typing import NamedTuple

GRACE_S = 3.0
LOG, ENDING, USAGE = "log", "ending.json", "usage.json"
LEASE = "lease"
LOG_IS_FULL = b"\n[kleinkram] the log is full: the output from here on is not stored\n"
_DISK_EVERY_S = 1.0
# An empty file takes space, too: an entry of its directory and an inode.
_ENTRY_BYTES = 1024
# Of the kernel's flags of a process: PF_EXITING.
_IS_EXITING = 4
_SHORT_BYTES = 128
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_RESERVED_BYTES = 4096

CANCELLED = ("cancelled", "It was cancelled.")
DISK_FULL = ("disk", "The disk of its runner is full. Run it again once there is space.")
LEASE_EXPIRED = ("lost", "It had no news from its runner for too long. Run it again with klein run retry.")


class JobLimits(NamedTuple):
    """Limits of one job."""

    memory_bytes: int
    disk_bytes: int
    time_s: int
    log_bytes: int


class LimitMonitor:
    """Decides when a job must end. The first reason counts."""

    def __init__(self, directory: Path, limits: JobLimits) -> None:
        self._directory = directory
        self._limits = limits
        self.reason: tuple[str, str] | None = None
        self._kill_at_s = 0.0
        self._is_term_sent = False
        self._disk_at_s = 0.0

    def stop(self, reason: tuple[str, str], *, grace_s: float = GRACE_S) -> None:
        """Have the job ended: by SIGTERM, then by SIGKILL `grace_s` later."""
        if self.reason is None:
            self._kill_at_s = time.monotonic() + grace_s
            self.reason = reason

    def next_signal(self) -> signal.Signals | None:
        """Return the signal that is due now, if any."""
        if self.reason is None:
            return None
        if time.monotonic() >= self._kill_at_s:
            return signal.SIGKILL
        if self._is_term_sent:
            return None
        self._is_term_sent = True
        return signal.SIGTERM

    def check(self, elapsed_s: float) -> None:
        """Check time, lease and disk."""
        if elapsed_s > self._limits.time_s:
            self.stop(("time", f"It ran longer than its limit of {self._limits.time_s} s."))
        if self.is_lease_expired():
            self.stop(LEASE_EXPIRED, grace_s=0)
        started_s = time.monotonic()
        if started_s >= self._disk_at_s:
            self.check_disk()
            # Measuring very many files takes long: spend at most a tenth of the time on it.
            self._disk_at_s = time.monotonic() + max(_DISK_EVERY_S, 10 * (time.monotonic() - started_s))

    def is_lease_expired(self) -> bool:
        """Whether the lease in the directory has expired. One from before a restart, or of another machine, has not."""
        try:
            until_s, of_boot = (self._directory / LEASE).read_text().split()
            return of_boot == boot_id() and boot_time_s() >= float(until_s)
        except (FileNotFoundError, ValueError):
            return False

    def check_disk(self) -> None:
        """Check what the job has written to `/out` and `/tmp`."""
        if sum(_disk_usage_bytes(self._directory / name) for name in ("out", "tmp")) > self._limits.disk_bytes:
            self.stop(over_disk_limit(self._limits.disk_bytes), grace_s=0)

    def check_memory(self, memory_bytes: int) -> None:
        """Check the memory of all processes together."""
        if memory_bytes > self._limits.memory_bytes:
            self.stop(out_of_memory(self._limits.memory_bytes), grace_s=0)


def _disk_usage_bytes(directory: Path) -> int:
    """Return the disk space of all entries below a directory; links are not followed."""
    total = 0
    pending = [str(directory)]
    while pending:
        # Entries may disappear at any moment.
        with contextlib.suppress(OSError), os.scandir(pending.pop()) as entries:
            for entry in entries:
                total += entry.stat(follow_symlinks=False).st_blocks * 512 + _ENTRY_BYTES
                if entry.is_dir(follow_symlinks=False):
                    pending.append(entry.path)
    return total


def boot_time_s() -> float:
    """Return the time since this machine was started, sleep included: the clock of leases, which nobody sets."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if clock is None else time.clock_gettime(clock)


def boot_id() -> str:
    """Return what `boot_time_s` counts from: it differs between machines, and after a restart."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return "unknown"


def write_lease(directory: Path, until_s: float, *, create: bool) -> None:
    """Write the lease of a job, by the clock of `boot_time_s`.

    Raises:
        OSError: it has no lease and `create` is false, or that cannot be written.
    """
    write_in_place(directory / LEASE, f"{until_s} {boot_id()}", create=create)


def reason_of_exit_code(code: int) -> tuple[str, str]:
    """Return the reason and sentence for an exit code, which is 128 + n after the signal n."""
    if code == 0:
        return "done", ""
    if code > 128 and code - 128 in {*signal.Signals}:
        return "signal", f"It was ended by the signal {signal.Signals(code - 128).name}."
    return "exit_code", f"It ended with the exit code {code}."


def out_of_memory(memory_bytes: int) -> tuple[str, str]:
    """Return the reason and sentence for a job that exceeded its memory."""
    return "memory", f"It used more memory than its limit of {_mb(memory_bytes)}."


def over_disk_limit(disk_bytes: int) -> tuple[str, str]:
    """Return the reason and sentence for a job that wrote more than it may."""
    return "disk", f"It wrote more than its limit of {_mb(disk_bytes)} to disk."


def command_not_found(detail: str) -> tuple[str, str]:
    """Return the reason and sentence for a command that cannot be executed."""
    return "command_not_found", f"The command could not be started: {detail}."


def _mb(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:,.0f} MB"


def read_log_of(directory: Path, offset: int, size_bytes: int) -> bytes:
    """Return bytes of the log in the directory of a job; empty where there are none yet."""
    try:
        with (directory / LOG).open("rb") as stream:
            stream.seek(offset)
            return stream.read(size_bytes)
    except FileNotFoundError:
        return b""


def start_ticks(pid: int) -> int | None:
    """Return when a process started, in clock ticks since boot; None where it is exiting, or has exited."""
    with contextlib.suppress(OSError):
        # The name, which stands in parentheses, may contain anything.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        # An exiting process loses its memory, namespaces and control groups before it becomes a zombie.
        return None if fields[0] == "Z" or int(fields[6]) & _IS_EXITING else int(fields[19])
    return None


def write_in_place(path: Path, text: str, *, create: bool = True) -> None:
    """Overwrite a short file, which needs no further disk space.

    Raises:
        OSError: it cannot be written, or does not exist and `create` is false.
    """
    descriptor = os.open(path, os.O_WRONLY | (os.O_CREAT if create else 0) | os.O_CLOEXEC, 0o600)
    try:
        # A single write of constant length is atomic.
        os.pwrite(descriptor, text.ljust(_SHORT_BYTES).encode(), 0)
    finally:
        os.close(descriptor)


def write_atomically(path: Path, text: str) -> None:
    """Replace a file of mode 0600; space that was reserved for it is used."""
    temporary = _temporary(path)
    with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600), "w") as stream:
        stream.write(text)
        stream.truncate()
        stream.flush()
        os.fsync(stream.fileno())
    temporary.replace(path)


def ending_file(directory: Path, start: str = "") -> Path:
    """Return where the ending of a job is, whose directory is used by several starts: of one of them, by its token."""
    return directory / (f"ending-{start}.json" if start else ENDING)


def reserve(path: Path) -> None:
    """Reserve disk space for a later `write_atomically`.

    Raises:
        OSError: the disk is full.
    """
    with _temporary(path).open("wb") as stream:
        stream.write(bytes(_RESERVED_BYTES))
        stream.flush()
        os.fsync(stream.fileno())


def move_reserved(source: Path, target: Path) -> None:
    """Have the space that was reserved for a file be that of another; reserve it where it is gone, if there is some."""
    with contextlib.suppress(OSError):
        try:
            _temporary(source).rename(_temporary(target))
        except FileNotFoundError:
            reserve(target)


def _temporary(path: Path) -> Path:
    return path.with_name(path.name + ".new")


def write_all(descriptor: int, data: bytes) -> None:
    """Write all bytes to a file.

    Raises:
        OSError: the disk is full.
    """
    while data:
        data = data[os.write(descriptor, data) :]
