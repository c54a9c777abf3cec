"""The cache of inputs: files named by their sha256, which jobs get as hard links.

One folder serves all threads, processes and machines that see it, on a local disk or on a shared file system:

    <sha256>.file          a verified file, 0444; a job that uses it has a further hard link to it
    <sha256>.seal          size, modification time and inode of that file; its time is that of the last use
    <sha256>-<size>.part   a download, held (flock) by the process that downloads; the next one continues it
    lock                   held while files are evicted

A file is verified once, during the download. From then on its seal shows that it is still the same file; it is not read
again. The seal is written before the part becomes the file, by one rename: a kill at any moment leaves a whole file, or
a part. The kernel releases the lock of a process that dies, and a server of NFS that of a machine that dies.

Nothing depends on eviction being seen in time: a file is evicted while it has no further link, and whoever links it too
late downloads it again. Ages are measured by the clock of the file system, never by those of two machines.
"""

import contextlib
import errno
import fcntl
import hashlib
import os
import shutil
import stat
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.runners import RunAssignment

_SUFFIX = ".file"
_SEAL = ".seal"
_PART = ".part"
_NEW = ".new"
_LOCK = "lock"
# Left free on the disk for others.
_SPARE_BYTES = 256 * 2**20
_SLICE_BYTES = 2**20
_PART_LIFETIME_S = 86_400.0
_CHECK_AGES_EVERY_S = 3600.0
_FIRST_PAUSE_S = 0.05
_LONGEST_PAUSE_S = 1.0
# Evictions are short. Should another one hang, two at once do no harm but to evict too much.
_EVICTION_WAIT_S = 10.0
_S = 1_000_000_000
_MODE = 0o444
_FULL_ERRORS = {errno.ENOSPC, errno.EDQUOT}
# Errors of a file system without hard links, or of a file with the maximum number of links.
_NO_LINK_ERRORS = {errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP, errno.EXDEV}
_NO_LOCKS = "its file system has no file locks (mount Lustre with the option flock); choose a folder on another one"
_NO_LOCK_ERRORS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}
# Errors of a file that another process, or another machine, has removed.
_GONE_ERRORS = {errno.ENOENT, errno.ESTALE}

Fetch = Callable[["PartialInput"], None]
Wait = Callable[[float], None]


@dataclass(frozen=True)
class InputFile:
    """The content of an input."""

    sha256: str
    size_bytes: int


# Places a cached file for a job; False where it was evicted meanwhile.
Place = Callable[[InputFile], bool]


class NoSpace(Exception):
    """The disk has no space for the inputs, or takes nothing. `is_full`: it may once something is removed."""

    is_full = False


class InputDamaged(Exception):
    """The downloaded bytes do not match the checksum."""


class InputFetcher(Protocol):
    """Downloads input files."""

    def fetch_into(self, cache: "InputCache", missing: Sequence[InputFile], place: Place) -> None:
        """Add files to a cache, and `place` each as soon as it is there; where that returns False, once more.

        Raises where one is not available, or the job is to stop.
        """


class InputSource(InputFetcher, Protocol):
    """Downloads the input files of a run, or tells another process what it needs to do so."""

    @property
    def assignment(self) -> RunAssignment:
        """The run."""

    def wait(self, seconds: float) -> None:
        """Wait; raises where the run is to stop."""

    def show(self, message: str, fraction: float) -> None:
        """Show people what takes long."""


class PartialInput:
    """A file being downloaded, which no other process downloads meanwhile. It continues an interrupted download."""

    def __init__(self, path: Path, file: InputFile, descriptor: int) -> None:
        self.file = file
        self._path = path
        self._descriptor = descriptor
        self._checksum = hashlib.sha256()
        self.offset = 0
        while data := os.pread(descriptor, _SLICE_BYTES, self.offset):
            self._checksum.update(data)
            self.offset += len(data)

    @classmethod
    def open(cls, path: Path, file: InputFile) -> "PartialInput | None":
        """Lock and open it; None while another process downloads it.

        Raises:
            NoSpace: the disk is full.
        """
        try:
            descriptor = _lock_file(path, os.O_CREAT)
            return None if descriptor is None else cls(path, file, descriptor)
        except OSError as error:
            raise _no_space(error, path) from error

    def add(self, data: bytes) -> None:
        """Append bytes; those beyond the size of the file are dropped.

        Raises:
            NoSpace: the disk is full.
        """
        data = data[: self.file.size_bytes - self.offset]
        view = memoryview(data)
        try:
            while view:
                # At its own place: should locks not hold between two machines, both write the same bytes there.
                written = os.pwrite(self._descriptor, view, self.offset)
                self._checksum.update(view[:written])
                self.offset += written
                view = view[written:]
        except OSError as error:
            raise _no_space(error, self._path) from error

    def verify(self) -> os.stat_result:
        """Check the size and the checksum, flush the file to disk, and return its status, which does not change.

        Raises:
            InputDamaged: they do not match.
            NoSpace: the disk is full.
        """
        if self.offset != self.file.size_bytes or self._checksum.hexdigest() != self.file.sha256:
            raise InputDamaged(f"the store returned other bytes than those with the sha256 {self.file.sha256}")
        try:
            os.fsync(self._descriptor)
            # Whole seconds, which every file system stores, and which no late write of this process changes.
            modified_ns = os.fstat(self._descriptor).st_mtime_ns // _S * _S
            os.utime(self._descriptor, ns=(modified_ns, modified_ns))
        except OSError as error:
            raise _no_space(error, self._path) from error
        return os.fstat(self._descriptor)

    def is_current(self) -> bool:
        """Whether the file still has its name, by which it is to become complete."""
        return _is_at(self._path, self._descriptor)

    def discard(self) -> None:
        """Remove what was downloaded. It cannot be continued: another process may still have the file open."""
        if self.is_current():
            self._path.unlink(missing_ok=True)

    def close(self) -> None:
        """Close and unlock it; what was downloaded stays."""
        with contextlib.suppress(OSError):
            os.close(self._descriptor)


class _Entry(NamedTuple):
    """What may be evicted: `lifetime_s` after its last use, or, unless that gives none, for lack of space."""

    path: Path
    size_bytes: int
    used_ns: int
    lifetime_s: float | None
    gives_space: bool = True


class _Contents(NamedTuple):
    """What is in a cache. `coming_bytes` are those that running downloads, and those to be started, still add."""

    total_bytes: int
    coming_bytes: int
    evictable: list[_Entry]


class InputCache:
    """A cache in one directory, of at most `limit_bytes` beside the files in use; unused files stay for `max_age_s`.

    Raises InvalidInput where the directory cannot be used, or its file system has no locks.
    """

    def __init__(self, directory: Path, limit_bytes: int, max_age_s: float | None = None) -> None:
        self.directory = directory
        self.limit_bytes = limit_bytes
        self.max_age_s = max_age_s
        try:
            directory.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._ages_checked_s = time.monotonic()
            self._evict()
        except OSError as error:
            reason = _NO_LOCKS if error.errno in _NO_LOCK_ERRORS else error.strerror or str(error)
            raise InvalidInput(what=f"The cache of inputs {directory}", reason=reason) from error

    def size_bytes(self) -> int:
        """Return the size of all files."""
        return sum(status.st_size for _, status in self._matching(_SUFFIX))

    def place(self, file: InputFile, targets: Sequence[Path], *, copy: bool = False) -> bool:
        """Link a cached file, or copy it, also where links are not possible; it counts as used now.

        Returns False where it is not cached.
        """
        if not self._is_cached(file):
            return False
        for target in targets:
            target.unlink(missing_ok=True)
            try:
                self._add(file, target, copy=copy)
            except OSError as error:
                # Evicted just now, unless the target is the problem.
                if error.errno in _GONE_ERRORS and target.parent.is_dir():
                    return False
                raise
        return True

    def make_space(self, missing: Collection[InputFile]) -> None:
        """Evict the least recently used files until there is space for the missing ones.

        Raises:
            NoSpace: there is not, with all unused files removed.
        """
        lacking_bytes, needed_bytes = self._evict(missing)
        if lacking_bytes > 0:
            free = shutil.disk_usage(self.directory).free
            message = f"Its inputs need {_gb(needed_bytes)} on the runner's disk, where {_gb(free)} are free."
            raise NoSpace(message)

    def evict_old(self) -> None:
        """Evict what is too old, at most once an hour."""
        if time.monotonic() - self._ages_checked_s > _CHECK_AGES_EVERY_S:
            self._ages_checked_s = time.monotonic()
            self._evict()

    def get(self, file: InputFile, fetch: Fetch, wait: Wait) -> None:
        """Download a file unless it is cached. One of all callers does so; the others call `wait` (seconds).

        Damaged bytes are downloaded a second time. On a full disk, or at the quota of a user, unused files are evicted.

        Raises:
            InputDamaged: they were damaged again.
            NoSpace: the disk is full.
        """
        pause_s, is_second = _FIRST_PAUSE_S, False
        while not self._is_cached(file):
            part = PartialInput.open(self._part(file), file)
            if part is None:
                wait(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
                continue
            try:
                self._complete(part, fetch)
            except InputDamaged:
                part.discard()
                if is_second:
                    raise
                is_second = True
            except NoSpace as error:
                if not (error.is_full and self._evict_for(part)):
                    raise
            finally:
                part.close()

    def _complete(self, part: PartialInput, fetch: Fetch) -> None:
        """Download the rest of a file, and give it its seal and its name."""
        file = part.file
        if self._is_cached(file):  # since before it was locked
            part.discard()
            return
        fetch(part)
        status = part.verify()
        seal = self._path(file).with_suffix(_SEAL)
        aside = seal.with_suffix(_NEW + _SEAL)
        try:
            aside.write_text(_seal_of(status))
            aside.replace(seal)
            if part.is_current():
                self._part(file).replace(self._path(file))
        except OSError as error:
            raise _no_space(error, seal) from error

    def _add(self, file: InputFile, target: Path, *, copy: bool) -> None:
        if not copy:
            try:
                target.hardlink_to(self._path(file))
                return
            except OSError as error:
                if error.errno not in _NO_LINK_ERRORS:
                    raise
        shutil.copyfile(self._path(file), target)
        target.chmod(_MODE)

    def _is_cached(self, file: InputFile) -> bool:
        path = self._path(file)
        seal = path.with_suffix(_SEAL)
        try:
            status = path.stat()
            if seal.read_text() != _seal_of(status):
                return False  # changed: it is replaced, and jobs that use the old one keep it
            if stat.S_IMODE(status.st_mode) != _MODE:
                path.chmod(_MODE)
            os.utime(seal)
        except OSError as error:
            if error.errno not in _GONE_ERRORS:
                raise
            return False
        return True

    def _evict_for(self, part: PartialInput) -> bool:
        """Evict unused files for the rest of a download, as the disk is full; return whether there were any."""
        before_bytes = lacking_bytes = part.file.size_bytes - part.offset
        return self._evict(lacking_bytes=lacking_bytes)[0] < before_bytes

    def _evict(self, missing: Collection[InputFile] = (), lacking_bytes: int = 0) -> tuple[int, int]:
        """Evict what is too old, then the least recently used until the missing files and `lacking_bytes` fit.

        Returns the bytes that the disk still lacks, and those that are to come.
        """
        with self._eviction_lock() as now_ns:
            contents = self._read_contents(missing)
            excess_bytes = contents.total_bytes + contents.coming_bytes - self.limit_bytes
            if missing:
                free_bytes = shutil.disk_usage(self.directory).free
                lacking_bytes = contents.coming_bytes + _SPARE_BYTES - free_bytes
            for entry in sorted(contents.evictable, key=lambda entry: entry.used_ns):
                is_old = entry.lifetime_s is not None and now_ns - entry.used_ns > entry.lifetime_s * _S
                is_in_the_way = entry.gives_space and max(excess_bytes, lacking_bytes) > 0
                if (is_old or is_in_the_way) and _remove(entry.path):
                    excess_bytes -= entry.size_bytes
                    lacking_bytes -= entry.size_bytes
        return lacking_bytes, contents.coming_bytes

    @contextlib.contextmanager
    def _eviction_lock(self) -> Iterator[int]:
        """Wait until nobody else evicts; yield the time of the file system."""
        path, deadline = self.directory / _LOCK, time.monotonic() + _EVICTION_WAIT_S
        while (descriptor := _lock_file(path, os.O_CREAT)) is None and time.monotonic() < deadline:
            time.sleep(_FIRST_PAUSE_S)
        try:
            os.utime(path)
            yield path.stat().st_mtime_ns
        finally:
            if descriptor is not None:
                os.close(descriptor)

    def _read_contents(self, missing: Collection[InputFile]) -> _Contents:
        coming = {self._part(file): file.size_bytes for file in missing}
        evictable, total_bytes = [], 0
        for path, status in self._matching(_PART):
            total_bytes += status.st_size
            if _is_locked(path):
                coming[path] = _size_of(path)
            elif path not in coming:
                evictable.append(_Entry(path, status.st_size, status.st_mtime_ns, _PART_LIFETIME_S))
            if path in coming:
                coming[path] = max(0, coming[path] - status.st_size)
        seals = {path.stem: status.st_mtime_ns for path, status in self._matching(_SEAL)}
        for path, status in self._matching(_SUFFIX):
            total_bytes += status.st_size
            used_ns = seals.pop(path.stem, 0)
            if status.st_nlink == 1:
                evictable.append(_Entry(path, status.st_size, used_ns, self.max_age_s))
        for name, used_ns in seals.items():
            # Of a file that is gone; or it is about to come, since the seal is written before.
            evictable.append(_Entry(self.directory / (name + _SEAL), 0, used_ns, _PART_LIFETIME_S, gives_space=False))
        return _Contents(total_bytes, sum(coming.values()), evictable)

    def _matching(self, suffix: str) -> list[tuple[Path, os.stat_result]]:
        files = []
        for path in self.directory.glob("*" + suffix):
            with contextlib.suppress(FileNotFoundError):
                files.append((path, path.stat()))
        return files

    def _path(self, file: InputFile) -> Path:
        return self.directory / (file.sha256 + _SUFFIX)

    def _part(self, file: InputFile) -> Path:
        return self.directory / f"{file.sha256}-{file.size_bytes}{_PART}"


def _lock_file(path: Path, flags: int = 0) -> int | None:
    """Open and lock a file; None where another process, or another thread, has locked it."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC | flags, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(path, descriptor):
                locked, descriptor = descriptor, -1
                return locked
        except BlockingIOError:
            return None
        finally:
            if descriptor >= 0:
                os.close(descriptor)


def _is_locked(path: Path) -> bool:
    try:
        descriptor = _lock_file(path)
    except OSError:
        return False
    if descriptor is not None:
        os.close(descriptor)
    return descriptor is None


def _is_at(path: Path, descriptor: int) -> bool:
    """Whether an open file still has its name: another process may have removed or renamed it before it was locked."""
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except OSError as error:
        if error.errno not in _GONE_ERRORS:
            raise
        return False


def _remove(path: Path) -> bool:
    """Remove a file, its seal, or an abandoned download; return whether that was possible."""
    try:
        if path.suffix == _PART:
            descriptor = _lock_file(path)
            if descriptor is None:
                return False
            try:
                path.unlink()
            finally:
                os.close(descriptor)
            return True
        path.unlink(missing_ok=True)
        if path.suffix == _SUFFIX:
            path.with_suffix(_SEAL).unlink(missing_ok=True)
    except OSError as error:
        return error.errno in _GONE_ERRORS
    return True


def _size_of(part: Path) -> int:
    return int(part.stem.rpartition("-")[2])


def _seal_of(status: os.stat_result) -> str:
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ino}"


def _no_space(error: OSError, path: Path) -> NoSpace:
    failure = NoSpace(f"The folder {path.parent} of the runner takes no more: {error.strerror}.")
    failure.is_full = error.errno in _FULL_ERRORS
    return failure


def _gb(size_bytes: int) -> str:
    return f"{size_bytes / 1e9:,.1f} GB"


def place_inputs(
    cache: InputCache, directory: Path, files: Mapping[str, InputFile], source: InputFetcher, *, copy: bool
) -> None:
    """Provide files of a cache in a directory, by their relative paths; those that are missing are downloaded.

    Raises:
        NoSpace: the disk has no space for them.
        OSError: they cannot be placed.
    """
    targets: dict[InputFile, list[Path]] = {}
    for path, file in files.items():
        target = directory / path
        target.parent.mkdir(parents=True, exist_ok=True)
        targets.setdefault(file, []).append(target)

    def place(file: InputFile) -> bool:
        # At once: a link protects a file from eviction while the others are downloaded.
        return cache.place(file, targets[file], copy=copy)

    if missing := [file for file in targets if not place(file)]:
        cache.make_space(missing)
        source.fetch_into(cache, missing, place)
