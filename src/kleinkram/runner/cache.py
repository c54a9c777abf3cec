"""The inputs of runs, on this machine's disk: files named by their sha256, which runs get as hard links.

A file's bytes are verified once, while they come. From then on its seal (size, time of change, inode) tells that it is
still that file; it is not read again. What a run uses has more than one name, and is never removed.
"""

import contextlib
import errno
import hashlib
import os
import shutil
import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

_SUFFIX = ".file"
_SEAL = ".seal"
_PART = ".part"
# A disk is not filled to its last byte: others live on it, too.
_SPARE_BYTES = 256 * 2**20
_SLICE_BYTES = 2**20
_PART_LASTS_S = 86_400.0
# A file system without hard links, or a file that has as many names as it can have.
_NO_LINK = {errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP, errno.EXDEV}

Fetch = Callable[["Part"], None]


@dataclass(frozen=True)
class Wanted:
    """Bytes that a run needs."""

    sha256: str
    size_bytes: int


class NoRoom(Exception):
    """The disk, or what of it is for inputs, does not hold all that runs need."""


class Damaged(Exception):
    """What came are not the bytes that were promised."""


class Part:
    """A file that is on its way. What an earlier attempt left of it counts."""

    def __init__(self, path: Path, wanted: Wanted) -> None:
        self.wanted = wanted
        self._stream = path.open("a+b")
        self._checksum = hashlib.sha256()
        self._stream.seek(0)
        while data := self._stream.read(_SLICE_BYTES):
            self._checksum.update(data)
        self.offset = self._stream.tell()
        if self.offset > wanted.size_bytes:
            self.begin_again()

    def begin_again(self) -> None:
        """Forget what has come."""
        self._stream.truncate(0)
        self._checksum, self.offset = hashlib.sha256(), 0

    def add(self, data: bytes) -> None:
        """Take the bytes that come next; what is beyond the file's size is dropped.

        Raises:
            NoRoom: the disk is full.
        """
        data = data[: self.wanted.size_bytes - self.offset]
        try:
            self._stream.write(data)
        except OSError as error:
            raise NoRoom(f"The runner's disk takes no more: {error.strerror}.") from error
        self._checksum.update(data)
        self.offset += len(data)

    def verify(self) -> None:
        """See that all came, and force it to disk.

        Raises:
            Damaged: they are other bytes.
            NoRoom: the disk is full.
        """
        if self.offset != self.wanted.size_bytes or self._checksum.hexdigest() != self.wanted.sha256:
            raise Damaged(f"the store gave other bytes than those with the sha256 {self.wanted.sha256}")
        try:
            self._stream.flush()
            os.fchmod(self._stream.fileno(), 0o444)
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise NoRoom(f"The runner's disk takes no more: {error.strerror}.") from error

    def close(self) -> None:
        """Close it; what has come stays."""
        with contextlib.suppress(OSError):
            self._stream.close()


class Cache:
    """The cache of one runner. `limit_bytes` is what it keeps at most of what no run uses. From any thread."""

    def __init__(self, folder: Path, limit_bytes: int) -> None:
        self._folder = folder
        self._limit_bytes = limit_bytes
        self._lock = threading.Lock()
        self._arrived = threading.Condition(self._lock)
        self._fetching: dict[str, int] = {}
        self._pinned: dict[str, int] = {}
        folder.mkdir(mode=0o711, parents=True, exist_ok=True)
        for part in folder.glob("*" + _PART):
            # What nobody went on with since.
            if time.time() - part.stat().st_mtime > _PART_LASTS_S:
                part.unlink()

    def size_bytes(self) -> int:
        """Return what it keeps, in use or not."""
        return sum(status.st_size for _, status in self._files())

    @contextlib.contextmanager
    def pinned(self, wanted: Collection[Wanted]) -> Iterator[None]:
        """Keep these from being removed while they are fetched and linked."""
        names = {each.sha256 for each in wanted}
        with self._lock:
            for name in names:
                self._pinned[name] = self._pinned.get(name, 0) + 1
        try:
            yield
        finally:
            with self._lock:
                for name in names:
                    self._pinned[name] -= 1
                    if not self._pinned[name]:
                        del self._pinned[name]

    def missing(self, wanted: Collection[Wanted]) -> list[Wanted]:
        """Return what is not here yet, each once; what is here counts as used now."""
        return [each for each in dict.fromkeys(wanted) if not self._is_here(each)]

    def make_room(self, missing: Collection[Wanted]) -> None:
        """Remove what was not used for longest, until there is room for what is missing.

        Raises:
            NoRoom: there is not, with all removed that no run uses.
        """
        with self._lock:
            needed = sum(each.size_bytes for each in missing if each.sha256 not in self._fetching)
            coming = sum(self._fetching.values())
            kept = self._files()
            surplus = sum(status.st_size for _, status in kept) + needed + coming - self._limit_bytes
            lacking = needed + coming + _SPARE_BYTES - shutil.disk_usage(self._folder).free
            for path, status in sorted(kept, key=lambda each: _used_ns(each[0])):
                if max(surplus, lacking) <= 0:
                    return
                if status.st_nlink == 1 and path.stem not in self._pinned:
                    self._remove(path)
                    surplus -= status.st_size
                    lacking -= status.st_size
        if lacking > 0:
            free = shutil.disk_usage(self._folder).free
            message = f"Its inputs take {_gb(needed)} on the runner's disk, where {_gb(free)} are free."
            raise NoRoom(message)

    def get(self, wanted: Wanted, fetch: Fetch, wait: Callable[[float], None]) -> None:
        """Have a file here. Of several that want it at once, one fetches; the others `wait` (seconds) meanwhile.

        Bytes that are not the promised ones are fetched a second time.

        Raises:
            Damaged: they were not then either.
            NoRoom: the disk is full.
        """
        while not self._is_here(wanted):
            if self._takes(wanted):
                try:
                    self._fetch(wanted, fetch)
                finally:
                    with self._lock:
                        del self._fetching[wanted.sha256]
                        self._arrived.notify_all()
                return
            wait(0)
            with self._arrived:
                self._arrived.wait_for(lambda: wanted.sha256 not in self._fetching, timeout=0.2)

    def link(self, wanted: Wanted, target: Path) -> None:
        """Give a file that is here another name, or where that cannot be, a copy of its own."""
        try:
            target.hardlink_to(self._path(wanted.sha256))
        except OSError as error:
            if error.errno not in _NO_LINK:
                raise
            self.copy(wanted, target)

    def copy(self, wanted: Wanted, target: Path) -> None:
        """Copy a file that is here."""
        shutil.copyfile(self._path(wanted.sha256), target)
        target.chmod(0o444)

    def _takes(self, wanted: Wanted) -> bool:
        with self._lock:
            if wanted.sha256 in self._fetching:
                return False
            self._fetching[wanted.sha256] = wanted.size_bytes
            return True

    def _fetch(self, wanted: Wanted, fetch: Fetch) -> None:
        path = self._folder / (wanted.sha256 + _PART)
        try:
            self._fetch_once(path, wanted, fetch)
        except Damaged:
            path.unlink(missing_ok=True)
            try:
                self._fetch_once(path, wanted, fetch)
            except Damaged:
                path.unlink(missing_ok=True)
                raise

    def _fetch_once(self, path: Path, wanted: Wanted, fetch: Fetch) -> None:
        try:
            part = Part(path, wanted)
        except OSError as error:
            raise NoRoom(f"The runner's disk takes nothing: {error.strerror}.") from error
        try:
            fetch(part)
            part.verify()
        finally:
            part.close()
        seal = self._folder / (wanted.sha256 + _SEAL)
        # Only with its seal it counts, which is written last.
        path.replace(self._path(wanted.sha256))
        aside = seal.with_name(seal.name + ".new")
        aside.write_text(_seal_of(self._path(wanted.sha256).stat()))
        aside.replace(seal)

    def _is_here(self, wanted: Wanted) -> bool:
        path = self._path(wanted.sha256)
        seal = path.with_suffix(_SEAL)
        try:
            is_sealed = seal.read_text() == _seal_of(path.stat())
        except FileNotFoundError:
            is_sealed = False
        if is_sealed:
            with contextlib.suppress(FileNotFoundError):
                os.utime(seal)
                return True
        with self._lock:
            # Its bytes may be another file's by now: they are fetched again, and who uses the old ones keeps them.
            if wanted.sha256 not in self._fetching:
                self._remove(path)
        return False

    def _remove(self, path: Path) -> None:
        path.with_suffix(_SEAL).unlink(missing_ok=True)
        path.unlink(missing_ok=True)

    def _path(self, sha256: str) -> Path:
        return self._folder / (sha256 + _SUFFIX)

    def _files(self) -> list[tuple[Path, os.stat_result]]:
        found = []
        for path in self._folder.glob("*" + _SUFFIX):
            with contextlib.suppress(FileNotFoundError):
                found.append((path, path.stat()))
        return found


def _seal_of(status: os.stat_result) -> str:
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ino}"


def _used_ns(path: Path) -> int:
    try:
        return path.with_suffix(_SEAL).stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def _gb(size_bytes: int) -> str:
    return f"{size_bytes / 1e9:,.1f} GB"
