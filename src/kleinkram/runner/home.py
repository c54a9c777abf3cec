"""The folder of a runner: who it is, what it is at, and its cache. One process at a time has it.

id        the runner's own, for good
heard     when the server last answered a beat
runs/     a folder for each run it holds
cache/    inputs
"""

import contextlib
import fcntl
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from kleinkram.client.errors import InvalidInput
from kleinkram.runner.disk import write_over, write_whole

_BOOT = Path("/proc/sys/kernel/random/boot_id")


class Home:
    """A runner's folder, which `open_home` gives."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.runs = folder / "runs"
        self.cache = folder / "cache"
        self.runner_id = self._id()
        self.runs.mkdir(mode=0o711, exist_ok=True)

    def used_bytes(self) -> int:
        """Return what runner and runs have on the disk already."""
        total = 0
        for here, _, names in os.walk(self.folder):
            for name in names:
                with contextlib.suppress(OSError):
                    status = (Path(here) / name).lstat()
                    total += status.st_blocks * 512 // status.st_nlink
        return total

    def note_heard(self, at_s: float) -> None:
        """Note that the server has answered a beat of then, by the clock of leases."""
        write_over(self.folder / "heard", f"{_boot()} {at_s}")

    def heard_s(self) -> float:
        """Return when it last did; 0 where that is not known, or the machine was started anew since."""
        with contextlib.suppress(OSError, ValueError):
            boot, at_s = (self.folder / "heard").read_text().split()
            if boot == _boot():
                return float(at_s)
        return 0.0

    def _id(self) -> uuid.UUID:
        path = self.folder / "id"
        if not path.exists():
            write_whole(path, f"{uuid.uuid4()}\n")
        try:
            return uuid.UUID(path.read_text().strip())
        except ValueError:
            raise InvalidInput(what=str(path), reason="it holds no id of a runner") from None


@contextlib.contextmanager
def open_home(folder: Path) -> Iterator[Home]:
    """Have a runner's folder, made where there is none, for this process alone.

    Raises:
        InvalidInput: another runner has it, or it cannot be used.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise InvalidInput(what=f"The folder {folder}", reason=error.strerror or str(error)) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield Home(folder)
    except BlockingIOError:
        raise InvalidInput(what=f"The folder {folder}", reason="another runner has it") from None
    finally:
        os.close(lock)


def _boot() -> str:
    try:
        return _BOOT.read_text().strip()
    except OSError:
        return "unknown"
