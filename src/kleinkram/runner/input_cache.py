"""The cache of inputs: files named by their sha256, which jobs get as hard links.

A file is verified once, during the download. From then on its seal (size, modification time, inode) shows that it is
still the same file; it is not read again. A file that a job uses has several links, and is never evicted.
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
# Left free on the disk for others.
_SPARE_BYTES = 256 * 2**20
_SLICE_BYTES = 2**20
_PART_LIFETIME_S = 86_400.0
# Errors of a file system without hard links, or of a file with the maximum number of links.
_NO_LINK_ERRORS = {errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP, errno.EXDEV}

Fetch = Callable[["PartialInput"], None]


@dataclass(frozen=True)
class InputFile:
    """The content of an input."""

    sha256: str
    size_bytes: int


class NoSpace(Exception):
    """The disk has no space for the inputs."""


class InputDamaged(Exception):
    """The downloaded bytes do not match the checksum."""


class PartialInput:
    """A file being downloaded. It continues the download that was interrupted before."""

    def __init__(self, path: Path, file: InputFile) -> None:
        self.file = file
        self._stream = path.open("a+b")
        self._checksum = hashlib.sha256()
        self._stream.seek(0)
        while data := self._stream.read(_SLICE_BYTES):
            self._checksum.update(data)
        self.offset = self._stream.tell()
        if self.offset > file.size_bytes:
            self.restart()

    def restart(self) -> None:
        """Discard what was downloaded."""
        self._stream.truncate(0)
        self._checksum, self.offset = hashlib.sha256(), 0

    def add(self, data: bytes) -> None:
        """Append bytes; those beyond the size of the file are dropped.

        Raises:
            NoSpace: the disk is full.
        """
        data = data[: self.file.size_bytes - self.offset]
        try:
            self._stream.write(data)
        except OSError as error:
            raise NoSpace(f"The runner's disk takes no more: {error.strerror}.") from error
        self._checksum.update(data)
        self.offset += len(data)

    def verify(self) -> None:
        """Check the size and the checksum, and flush the file to disk.

        Raises:
            InputDamaged: they do not match.
            NoSpace: the disk is full.
        """
        if self.offset != self.file.size_bytes or self._checksum.hexdigest() != self.file.sha256:
            raise InputDamaged(f"the store returned other bytes than those with the sha256 {self.file.sha256}")
        try:
            self._stream.flush()
            os.fchmod(self._stream.fileno(), 0o444)
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise NoSpace(f"The runner's disk takes no more: {error.strerror}.") from error

    def close(self) -> None:
        """Close it; what was downloaded stays."""
        with contextlib.suppress(OSError):
            self._stream.close()


class InputCache:
    """A cache in one directory, of at most `limit_bytes` beside the files in use. Thread-safe."""

    def __init__(self, directory: Path, limit_bytes: int) -> None:
        self._directory = directory
        self._limit_bytes = limit_bytes
        self._lock = threading.Lock()
        self._arrived = threading.Condition(self._lock)
        self._fetching: dict[str, int] = {}
        self._pinned: dict[str, int] = {}
        directory.mkdir(mode=0o711, parents=True, exist_ok=True)
        for part in directory.glob("*" + _PART):
            # Abandoned downloads.
            if time.time() - part.stat().st_mtime > _PART_LIFETIME_S:
                part.unlink()

    def size_bytes(self) -> int:
        """Return the size of all files."""
        return sum(status.st_size for _, status in self._files())

    @contextlib.contextmanager
    def pinned(self, files: Collection[InputFile]) -> Iterator[None]:
        """Protect files from eviction while they are downloaded and linked."""
        names = {file.sha256 for file in files}
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

    def missing(self, files: Collection[InputFile]) -> list[InputFile]:
        """Return the files that are not cached, without duplicates; cached ones count as used now."""
        return [file for file in dict.fromkeys(files) if not self._is_cached(file)]

    def make_space(self, missing: Collection[InputFile]) -> None:
        """Evict the least recently used files until there is space for the missing ones.

        Raises:
            NoSpace: there is not, with all unused files removed.
        """
        with self._lock:
            needed_bytes = sum(file.size_bytes for file in missing if file.sha256 not in self._fetching)
            incoming_bytes = sum(self._fetching.values())
            cached = self._files()
            excess_bytes = (
                sum(status.st_size for _, status in cached) + needed_bytes + incoming_bytes - self._limit_bytes
            )
            lacking_bytes = needed_bytes + incoming_bytes + _SPARE_BYTES - shutil.disk_usage(self._directory).free
            used_ns = {path.stem: path.stat().st_mtime_ns for path in self._directory.glob("*" + _SEAL)}
            for path, status in sorted(cached, key=lambda file: used_ns.get(file[0].stem, 0)):
                if max(excess_bytes, lacking_bytes) <= 0:
                    return
                if status.st_nlink == 1 and path.stem not in self._pinned:
                    self._remove(path)
                    excess_bytes -= status.st_size
                    lacking_bytes -= status.st_size
        if lacking_bytes > 0:
            free = shutil.disk_usage(self._directory).free
            message = f"Its inputs need {_gb(needed_bytes)} on the runner's disk, where {_gb(free)} are free."
            raise NoSpace(message)

    def get(self, file: InputFile, fetch: Fetch, wait: Callable[[float], None]) -> None:
        """Download a file unless it is cached. One of several callers does so; the others call `wait` (seconds).

        Damaged bytes are downloaded a second time.

        Raises:
            InputDamaged: they were damaged again.
            NoSpace: the disk is full.
        """
        while not self._is_cached(file):
            with self._lock:
                is_mine = file.sha256 not in self._fetching
                if is_mine:
                    self._fetching[file.sha256] = file.size_bytes
            if is_mine:
                try:
                    try:
                        self._fetch(file, fetch)
                    except InputDamaged:
                        self._fetch(file, fetch)
                finally:
                    with self._lock:
                        del self._fetching[file.sha256]
                        self._arrived.notify_all()
                return
            wait(0)
            with self._arrived:
                self._arrived.wait_for(lambda: file.sha256 not in self._fetching, timeout=0.2)

    def link(self, file: InputFile, target: Path) -> None:
        """Link a cached file, or copy it where links are not possible."""
        try:
            target.hardlink_to(self._path(file.sha256))
        except OSError as error:
            if error.errno not in _NO_LINK_ERRORS:
                raise
            self.copy(file, target)

    def copy(self, file: InputFile, target: Path) -> None:
        """Copy a cached file."""
        shutil.copyfile(self._path(file.sha256), target)
        target.chmod(0o444)

    def _fetch(self, file: InputFile, fetch: Fetch) -> None:
        path = self._directory / (file.sha256 + _PART)
        try:
            part = PartialInput(path, file)
        except OSError as error:
            raise NoSpace(f"The runner's disk takes nothing: {error.strerror}.") from error
        try:
            fetch(part)
            part.verify()
        except InputDamaged:
            path.unlink()
            raise
        finally:
            part.close()
        seal = self._directory / (file.sha256 + _SEAL)
        # The file counts once it has its seal, which is written last.
        path.replace(self._path(file.sha256))
        aside = seal.with_name(seal.name + ".new")
        aside.write_text(_seal_of(self._path(file.sha256).stat()))
        aside.replace(seal)

    def _is_cached(self, file: InputFile) -> bool:
        path = self._path(file.sha256)
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
            # It may have been changed: it is downloaded again, and jobs that use the old one keep it.
            if file.sha256 not in self._fetching:
                self._remove(path)
        return False

    def _remove(self, path: Path) -> None:
        path.with_suffix(_SEAL).unlink(missing_ok=True)
        path.unlink(missing_ok=True)

    def _path(self, sha256: str) -> Path:
        return self._directory / (sha256 + _SUFFIX)

    def _files(self) -> list[tuple[Path, os.stat_result]]:
        files = []
        for path in self._directory.glob("*" + _SUFFIX):
            with contextlib.suppress(FileNotFoundError):
                files.append((path, path.stat()))
        return files


def _seal_of(status: os.stat_result) -> str:
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ino}"


def _gb(size_bytes: int) -> str:
    return f"{size_bytes / 1e9:,.1f} GB"
