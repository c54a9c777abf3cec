"""A cache of folders, each built once, used by many processes, and never changed: environments, images.

    <key>/                  an entry
    <key>/complete.json     a description, written last, with its `size_bytes`; its time is that of the last use
    <key>.lock              held (flock) exclusively while the entry is built or removed, shared while it is used
    <key>.new-<random>/     an entry being built, renamed to <key> once it is complete

The locks hold between threads and between processes. A killed process leaves a folder `.new-...` that nothing uses, and
that the next build removes.
"""

import contextlib
import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

_COMPLETE, _LOCK, _NEW = "complete.json", ".lock", ".new-"


class EntryTooLarge(Exception):
    """An entry alone is larger than its cache."""


class FolderCache:
    """Folders in one folder, of at most `limit_bytes` beside those in use. For all threads and processes."""

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self._folder = folder
        self._limit_bytes = limit_bytes
        folder.mkdir(mode=0o711, parents=True, exist_ok=True)
        for abandoned in {path.name.partition(_NEW)[0] for path in folder.glob(f"*{_NEW}*")}:
            self._remove(abandoned, if_complete=False)

    def use(self, key: str) -> int | None:
        """Return the lock of an entry that is complete, in use until it is closed; None without it."""
        lock = self._open_lock(key)
        try:
            # Does not wait: whoever has the lock builds the entry, or removes it.
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            if self._is_current(key, lock) and self._is_complete(key):
                with contextlib.suppress(OSError):
                    os.utime(self._folder / key / _COMPLETE)
                used, lock = lock, -1
                return used
        except BlockingIOError:
            return None
        finally:
            if lock >= 0:
                os.close(lock)
        return None

    def make_folder(self, key: str) -> Path:
        """Return a new folder to build an entry in. The caller has its lock."""
        return Path(tempfile.mkdtemp(prefix=f"{key}{_NEW}", dir=self._folder))

    def publish(self, new: Path, key: str, description: Mapping[str, object]) -> None:
        """Make a folder that was built the entry of a key.

        Raises:
            EntryTooLarge: it alone is larger than the cache.
        """
        (new / _COMPLETE).write_text(json.dumps(description))
        new.chmod(0o711)
        self._make_space(int(str(description["size_bytes"])))
        # Otherwise, files could be empty after a power failure.
        os.sync()
        new.rename(self._folder / key)

    def _make_space(self, needed_bytes: int) -> None:
        """Remove the entries that were used longest ago, and by nobody now, for this one. Raises EntryTooLarge."""
        complete: list[tuple[float, int, str]] = []
        for path in self._folder.glob(f"*/{_COMPLETE}"):
            with contextlib.suppress(OSError, ValueError, KeyError):
                if _NEW not in path.parent.name:
                    complete.append(
                        (path.stat().st_mtime, json.loads(path.read_text())["size_bytes"], path.parent.name)
                    )
        if needed_bytes > self._limit_bytes:
            raise EntryTooLarge
        excess_bytes = sum(size_bytes for _, size_bytes, _ in complete) + needed_bytes - self._limit_bytes
        for _, size_bytes, key in sorted(complete):
            if excess_bytes <= 0:
                return
            if self._remove(key):
                excess_bytes -= size_bytes

    def _remove(self, key: str, *, if_complete: bool = True) -> bool:
        """Remove an entry, or what a killed build left, unless it is in use; return whether it was removed."""
        with self.try_lock(key) as lock:
            if lock is None or (not if_complete and self._is_complete(key)):
                return False
            self.remove_folders(key)
            (self._folder / f"{key}{_LOCK}").unlink(missing_ok=True)
        return True

    def remove_folders(self, key: str) -> None:
        """Remove an entry, and what killed builds of it left. The caller has its lock."""
        # No longer complete, if this process is killed now.
        (self._folder / key / _COMPLETE).unlink(missing_ok=True)
        remove_read_only(self._folder / key)
        for abandoned in self._folder.glob(f"{key}{_NEW}*"):
            # What compiled it may still write there; it is never used, and removed the next time.
            with contextlib.suppress(OSError):
                remove_read_only(abandoned)

    @contextlib.contextmanager
    def try_lock(self, key: str) -> Iterator[int | None]:
        """Yield a lock on an entry that nobody else builds or uses; None where somebody does."""
        lock = self._open_lock(key)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_locked = self._is_current(key, lock)
        except BlockingIOError:
            is_locked = False
        try:
            yield lock if is_locked else None
        finally:
            os.close(lock)

    def _open_lock(self, key: str) -> int:
        return os.open(self._folder / f"{key}{_LOCK}", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)

    def _is_current(self, key: str, lock: int) -> bool:
        """Whether a lock file is still the one that others open: it is removed together with its entry."""
        try:
            return os.fstat(lock).st_ino == (self._folder / f"{key}{_LOCK}").stat().st_ino
        except FileNotFoundError:
            return False

    def _is_complete(self, key: str) -> bool:
        """Whether an entry has all of its files."""
        return self._read_complete(key) is not None

    def _read_complete(self, key: str) -> dict[str, object] | None:
        try:
            return dict(json.loads((self._folder / key / _COMPLETE).read_text()))
        except (FileNotFoundError, ValueError, TypeError):
            return None


def remove_read_only(path: Path) -> None:
    """Remove a file or a folder, whatever its permissions; nothing where it does not exist."""
    if not path.is_dir() or path.is_symlink():
        path.unlink(missing_ok=True)
        return
    for parent, names, _ in os.walk(path):
        Path(parent).chmod(0o700)
        for name in names:
            if not (Path(parent) / name).is_symlink():
                (Path(parent) / name).chmod(0o700)
    shutil.rmtree(path)
