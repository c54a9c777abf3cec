"""Where a download writes its files: paths that stay inside the destination, and a temporary file for each."""

import fcntl
import hashlib
import os
import stat
import sys
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.errors import DestinationDiffers, DestinationRefused, DiskFull, PathsCollide, VerifyFailed
from kleinkram.client.transfer.plan import SLICE_BYTES, Checksum, Crc64Hash, distinct_text, read_slice
from kleinkram.client.transfer.pool import FileTransfer
from kleinkram.contract.files import DownloadLink, FileRead
from kleinkram.contract.names import MAX_PATH_PART_BYTES, check_file_path
from kleinkram.contract.runs import ArtifactRead

RANGE_BYTES = 8 * 1024 * 1024
PART_SUFFIX = ".klein-part"
JOURNAL_SUFFIX = ".klein-journal"


def make_folders(dest: Path, relative: str) -> Path:
    """Make the folders of a file below `dest`, and return its path. Links are followed only inside `dest`."""
    target = dest / relative
    root = Path(os.path.realpath(dest))
    for folder in [*reversed(target.relative_to(dest).parents)][1:]:
        here = dest / folder
        try:
            here.mkdir()
        except FileExistsError:
            real = Path(os.path.realpath(here))
            reason = None
            if root != real and root not in real.parents:
                reason = f"{str(here)!r} is a link that leads out of the destination"
            elif not here.is_dir():
                reason = f"{str(here)!r} is a file, and a folder is needed there"
            if reason is not None:
                raise DestinationRefused(path=relative, reason=reason) from None
        except OSError as error:
            raise DestinationRefused(path=str(target), reason=error.strerror or str(error)) from None
    return target


def partial_path(target: Path, suffix: str) -> Path:
    """Return the name beside a target with this suffix."""
    name = target.name
    while len((name + suffix).encode()) > MAX_PATH_PART_BYTES:
        name = name[:-1]
    return target.with_name(name + suffix)


def regular_size(target: Path) -> int | None:
    """Return the size of a file; None if there is none, -1 if it is not a regular file."""
    try:
        status = target.lstat()
    except FileNotFoundError:
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else -1


@dataclass(frozen=True)
class DownloadTarget:
    """A file of a mission, or an artifact of a run, and where it goes: `relative` below `dest`."""

    file: FileRead | ArtifactRead
    dest: Path
    relative: str

    @property
    def local(self) -> Path:
        """The path on this machine."""
        return self.dest / self.relative


@dataclass(frozen=True)
class DownloadPlan:
    """The files to download, and those whose names cannot be written here."""

    targets: list[DownloadTarget] = field(default_factory=list)
    left_out: list[DestinationRefused] = field(default_factory=list)

    @property
    def size_bytes(self) -> int:
        """The bytes of all files planned."""
        return sum(target.file.size_bytes for target in self.targets)

    def add(self, file: FileRead | ArtifactRead, dest: Path, relative: str) -> DownloadTarget | None:
        """Add a file, or leave it out when its name would lead out of `dest` or cannot be a file's name here."""
        try:
            target = DownloadTarget(file, dest, check_file_path(relative))
        except ValueError as error:
            reason = f"the server's name for it {error}"
            self.left_out.append(DestinationRefused(path=relative, reason=reason))
            return None
        self.targets.append(target)
        return target


def plan_download(files: Iterable[FileRead], dest: Path, *, nested: bool = False) -> DownloadPlan:
    """Return where these files go below `dest`: by their path in the mission, below project and mission if `nested`.

    Raises:
        PathsCollide: two files would have the same path, or one would be a folder of the other; names both.
    """
    plan = DownloadPlan()
    targets: dict[str, tuple[FileRead, DownloadTarget]] = {}
    for file in files:
        above = f"{file.mission.project.name}/{file.mission.name}/" if nested else ""
        if (target := plan.add(file, dest, above + file.path)) is None:
            continue
        other, first = targets.setdefault(target.relative, (file, target))
        if first is not target:
            raise _collision(target, file, other, nested=nested)
    for file, target in [*targets.values()]:
        for folder in PurePosixPath(target.relative).parents:
            if str(folder) in targets:
                raise _collision(target, file, targets[str(folder)][0], nested=nested)
    return plan


def _collision(target: DownloadTarget, file: FileRead, other: FileRead, *, nested: bool) -> PathsCollide:
    collision = PathsCollide(
        path=distinct_text(str(target.local)),
        first=distinct_text(_full_path(other)),
        second=distinct_text(_full_path(file)),
    )
    if not nested and file.mission.id != other.mission.id:
        collision.remedy = "keep the missions apart with --nested (in the SDK nested=True), or download one at a time"
    return collision


def _full_path(file: FileRead) -> str:
    return f"{file.mission.project.name}/{file.mission.name}/{file.path}"


class _Head(BaseModel):
    model_config = ConfigDict(frozen=True)

    file_id: uuid.UUID
    size_bytes: int
    sha256: str | None
    crc64nvme: str | None


class _Range(BaseModel):
    model_config = ConfigDict(frozen=True)

    number: int


class PartialFile(FileTransfer):
    """A file being downloaded to `target`: its temporary file, which ranges have arrived, and its checksum so far.

    Safe to share between threads. The thread that completes the next range hashes it, in order. A journal beside the
    target lists the ranges, so that the same command resumes.
    """

    def __init__(self, link: DownloadLink, target: Path, *, overwrite: bool) -> None:
        """Open the temporary file, and resume what an earlier run left; raise DestinationRefused where it cannot."""
        super().__init__(link.path, link.url)
        self.link = link
        self.target = target
        self.size_bytes = link.size_bytes
        self.fetched_bytes = 0
        self._overwrite = overwrite
        self._part = partial_path(target, PART_SUFFIX)
        self._journal_file = partial_path(target, JOURNAL_SUFFIX)
        self._hashing = threading.Lock()
        self._hashed_to = 0
        self._checksum: Checksum = hashlib.sha256() if link.sha256 else Crc64Hash()
        self._handle = _open_locked(self._part)
        head = _Head.model_validate(link, from_attributes=True)
        self._done = _read_journal(self._journal_file, head)
        if not self._done:
            self._journal_file.unlink(missing_ok=True)
            os.ftruncate(self._handle, 0)
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
        self._journal = os.open(self._journal_file, flags, 0o600) if self.size_bytes > RANGE_BYTES else -1
        if not self._done:
            self._append(head)
        os.ftruncate(self._handle, self.size_bytes)

    def missing(self) -> Iterator[tuple[int, int, int]]:
        """Yield (number, first, last) of the missing ranges, both ends inclusive."""
        for number, first in enumerate(range(0, self.size_bytes, RANGE_BYTES)):
            if number not in self._done:
                yield number, first, min(first + RANGE_BYTES, self.size_bytes) - 1

    def stored_bytes(self) -> int:
        """Return how many bytes an earlier run left."""
        return sum(min(RANGE_BYTES, self.size_bytes - number * RANGE_BYTES) for number in self._done)

    def write(self, offset: int, data: bytes) -> None:
        """Write bytes at an offset; raise DiskFull if there is no room."""
        view = memoryview(data)
        while view:
            try:
                written = os.pwrite(self._handle, view, offset)
            except OSError as error:
                raise self._no_room(error) from None
            view, offset = view[written:], offset + written

    def arrived(self, number: int, size_bytes: int) -> None:
        """Record a range that has arrived."""
        with self._lock:
            self._done.add(number)
            self.fetched_bytes += size_bytes
            if self._journal >= 0:
                self._append(_Range(number=number))

    def hash_ready(self, check: Callable[[], None]) -> None:
        """Hash what has arrived in order, unless another thread does."""
        while self._is_ready() and self._hashing.acquire(blocking=False):
            try:
                while self._is_ready():
                    self._hash_range(check)
            finally:
                self._hashing.release()

    def _is_ready(self) -> bool:
        return self._hashed_to < self.size_bytes and self._hashed_to // RANGE_BYTES in self._done

    def _hash_range(self, check: Callable[[], None]) -> None:
        end = min(self._hashed_to + RANGE_BYTES, self.size_bytes)
        while self._hashed_to < end:
            check()
            view = read_slice(self._handle, self._hashed_to, min(SLICE_BYTES, end - self._hashed_to))
            if not view:
                raise VerifyFailed(
                    path=str(self.target), reason="the temporary file was cut short while it was written"
                )
            self._checksum.update(view)
            self._hashed_to += len(view)
        if sys.platform == "linux":  # begin to write the range to disk, so that the last fsync waits less
            os.posix_fadvise(self._handle, max(0, end - RANGE_BYTES), RANGE_BYTES, os.POSIX_FADV_DONTNEED)

    def finish(self, check: Callable[[], None]) -> None:
        """Verify the file, force it to disk, and give it its name. Only after every range has arrived.

        Raises:
            VerifyFailed: the checksum differs; the bytes are removed.
            DestinationDiffers: there is another file at the target by now.
        """
        with self._hashing:
            while self._hashed_to < self.size_bytes:
                self._hash_range(check)
        expected = self.link.sha256 or self.link.crc64nvme
        if self._checksum.hexdigest() != expected:
            self.discard()
            kind = "sha256" if self.link.sha256 else "crc64nvme"
            reason = f"their {kind} is {self._checksum.hexdigest()}, and {expected} was expected"
            raise VerifyFailed(path=self.link.path, reason=reason)
        try:
            os.fsync(self._handle)
        except OSError as error:
            raise self._no_room(error) from None
        if not self._overwrite and regular_size(self.target) is not None:
            raise DestinationDiffers(path=str(self.target))
        try:
            self._part.replace(self.target)
        except OSError as error:
            raise DestinationRefused(path=str(self.target), reason=error.strerror or str(error)) from None
        self._journal_file.unlink(missing_ok=True)

    def discard(self) -> None:
        """Remove what has arrived."""
        self._part.unlink(missing_ok=True)
        self._journal_file.unlink(missing_ok=True)

    def close(self) -> None:
        """Close the files; what has arrived stays for the next run."""
        handles, self._handle, self._journal = (self._handle, self._journal), -1, -1
        for handle in handles:
            if handle >= 0:
                os.close(handle)

    def _append(self, line: BaseModel) -> None:
        if self._journal >= 0:
            try:
                os.write(self._journal, line.model_dump_json().encode() + b"\n")
            except OSError as error:
                raise self._no_room(error) from None

    def _no_room(self, error: OSError) -> DiskFull:
        return DiskFull(path=str(self.target), reason=error.strerror or str(error))


def _open_locked(part: Path) -> int:
    while True:
        try:
            handle = os.open(part, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise DestinationRefused(path=str(part), reason=error.strerror or str(error)) from None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(handle), part.lstat()):
                return handle
        except BlockingIOError:
            os.close(handle)
            raise DestinationRefused(path=str(part), reason="another klein process is downloading it") from None
        except FileNotFoundError:
            pass
        os.close(handle)  # another process has finished it


def _read_journal(file: Path, head: _Head) -> set[int]:
    try:
        lines = file.read_bytes().rpartition(b"\n")[0].splitlines()
        if not lines or _Head.model_validate_json(lines[0]) != head:
            return set()
        return {_Range.model_validate_json(line).number for line in lines[1:]}
    except (OSError, ValidationError):
        return set()
