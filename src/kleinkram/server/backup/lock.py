"""One process at a time writes to a backup location: a lock on a folder, or a renewed file in a remote store."""

import contextlib
import fcntl
import os
import re
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from kleinkram.server.backup.errors import BackupConflict, BackupLocationFull
from kleinkram.server.backup.rclone import Rclone

_RENEW_S = 60.0
_STALE_S = 600.0


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[Callable[[], None]]:
    """Lock a folder; the kernel ends the lock with the process.

    Raises:
        BackupConflict: another process has it.
    """
    try:
        descriptor = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise BackupLocationFull(f"{folder} cannot be written: {error.strerror or error}.") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise _conflict(str(folder)) from None
    try:
        yield lambda: None
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def lock_remote(rclone: Rclone, folder: str, name: str) -> Iterator[Callable[[], None]]:
    """Lock a remote location by a file in `folder`, renewed every minute; yields a check that it is still there.

    Raises:
        BackupConflict: another process has a lock that is younger than ten minutes; by the check: another process
            removed this one's, since it was silent for longer.
    """
    own = f"{_host()}.{os.getpid()}.{_start_ticks(os.getpid())}.{secrets.token_hex(6)}"

    def check() -> None:
        if own not in {file.path for file in rclone.files(folder)}:
            raise BackupConflict(
                f"This process was silent for ten minutes (was the machine asleep?), and another may have changed "
                f"{name} since: run the same command again. What was copied stays."
            )

    def renew() -> None:
        check()
        rclone.write(f"{folder}/{own}", b"lock\n")

    rclone.write(f"{folder}/{own}", b"lock\n")
    try:
        times = {file.path: file.modified_at for file in rclone.files(folder)}
        stale = [path for path in times if _is_stale(path, (times[own] - times[path]).total_seconds())]
        if times.keys() - {own, *stale}:
            raise _conflict(name)
        rclone.delete(folder, stale)
        with repeating(_RENEW_S, renew):
            yield check
    finally:
        rclone.delete(folder, [own])


@contextlib.contextmanager
def repeating(every_s: float, action: Callable[[], None]) -> Iterator[None]:
    """Do something repeatedly in a thread until the block ends; an exception ends only the repetition."""
    is_over = threading.Event()

    def run() -> None:
        with contextlib.suppress(Exception):
            while not is_over.wait(every_s):
                action()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def _is_stale(lock: str, silent_s: float) -> bool:
    """Whether a lock's process was silent for long, or ran on this machine and has ended."""
    host, _, process = lock.partition(".")
    pid, _, rest = process.partition(".")
    return silent_s > _STALE_S or (host == _host() and _start_ticks(int(pid)) != rest.partition(".")[0])


def _host() -> str:
    return re.sub(r"[^\w-]", "_", socket.gethostname())


def _start_ticks(pid: int) -> str:
    """When a process of this machine started; empty if it does not run. Source: proc(5), /proc/pid/stat, field 22."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
    except OSError:
        return ""


def _conflict(name: str) -> BackupConflict:
    return BackupConflict(f"Another process writes to the backups in {name}: wait until it ends, then try again.")
