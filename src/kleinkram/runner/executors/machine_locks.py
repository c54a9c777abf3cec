"""Locks that the runners of one machine share, whoever they belong to: for GPUs, and for what a runner promises.

A lock is held by its process and ends with it. Its file says what the holder wrote last.
"""

import contextlib
import fcntl
import json
import os
import re
from pathlib import Path
from typing import Any

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.runners import Capacity

_FOLDER = "kleinkram"
_RUNNER = "runner-"
# Everybody may make locks here, and nobody remove those of others, as in /tmp.
_MODE = 0o1777
_MAX_BYTES = 4096


def places() -> list[Path]:
    """Return the folders of this machine for locks, the best first."""
    own = os.environ.get("XDG_RUNTIME_DIR")
    return [Path("/run/lock"), *([Path(own)] if own else []), Path("/tmp")]  # noqa: S108  shared on purpose


def lock_directory() -> Path:
    """Return the folder of the locks, which is created where it does not exist.

    Raises:
        InvalidInput: there is none that this process can write to.
    """
    for place in places():
        folder = place / _FOLDER
        with contextlib.suppress(OSError):
            with contextlib.suppress(FileExistsError):
                folder.mkdir()
                folder.chmod(_MODE)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
    names = ", ".join(str(place / _FOLDER) for place in places())
    raise InvalidInput(what="The folder for locks of this machine", reason=f"none of these can be written to: {names}")


class MachineLock:
    """A lock of this machine, once it is `try_acquire`d."""

    def __init__(self, name: str) -> None:
        self.path = lock_directory() / re.sub(r"[^\w.-]", "_", name)
        self._file = -1

    def try_acquire(self) -> bool:
        """Take the lock; False while another process has it.

        Raises:
            OSError: the file cannot be opened.
        """
        descriptor = self._open()
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return False
        self._file = descriptor
        return True

    def close(self) -> None:
        """Release it."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def remove(self) -> None:
        """Remove its file, and release it. Only for locks that no two processes want."""
        with contextlib.suppress(OSError):
            self.path.unlink()
        self.close()

    def write(self, content: dict[str, Any]) -> None:
        """Replace what its file says, while it is held."""
        data = json.dumps(content).encode() if content else b""
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, data, 0)

    def read(self) -> dict[str, Any]:
        """Return what the last holder wrote; empty where that is nothing, or damaged."""
        with contextlib.suppress(OSError, ValueError), self.path.open("rb") as stream:
            content = json.loads(stream.read(_MAX_BYTES))
            if isinstance(content, dict):
                return content
        return {}

    def _open(self) -> int:
        flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
        # Not by one call: kernels refuse O_CREAT for a file of another user in a folder that everybody writes to.
        with contextlib.suppress(FileNotFoundError):
            return os.open(self.path, flags)
        with contextlib.suppress(FileExistsError):
            descriptor = os.open(self.path, flags | os.O_CREAT | os.O_EXCL, 0o666)
            os.fchmod(descriptor, 0o666)
            return descriptor
        return os.open(self.path, flags)


def announce(runner: str, capacity: Capacity) -> tuple[MachineLock | None, list[Capacity]]:
    """Announce what a runner offers, while the returned lock is held; return what the others of this machine offer.

    The lock is None where there is no place for it.
    """
    others: list[Capacity] = []
    try:
        own = MachineLock(f"{_RUNNER}{runner}")
        for path in sorted(own.path.parent.glob(f"{_RUNNER}*")):
            lock = MachineLock(path.name)
            if path == own.path:
                continue
            if not lock.try_acquire():
                with contextlib.suppress(ValueError):
                    others.append(Capacity.model_validate(lock.read()))
            else:
                # Of a runner that was killed; in a folder of all users, only its own user may remove it.
                lock.remove()
        if own.try_acquire():
            own.write(capacity.model_dump())
            return own, others
    except (InvalidInput, OSError):
        pass
    return None, others
