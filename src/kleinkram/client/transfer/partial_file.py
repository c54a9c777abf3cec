"""One file's download under way: its temporary file, which ranges are there, and its checksum so far.

The checksum is made in order, by whichever thread finds the next range complete, from the page cache. What is there is
written beside the target, a line a range, so that the same command resumes; the checksum of the whole is what decides.
"""

import contextlib
import fcntl
import hashlib
import os
import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from kleinkram.client.errors import DestinationDiffers, DestinationRefused, DiskFull, VerifyFailed
from kleinkram.client.transfer.destination import JOURNAL_SUFFIX, PART_SUFFIX, partial_path, regular_size
from kleinkram.client.transfer.local_file import SLICE_BYTES, Checksum, Crc64Hash, read_slice
from kleinkram.contract.files import DownloadLink

RANGE_BYTES = 8 * 1024 * 1024


class _Head(BaseModel):
    model_config = ConfigDict(frozen=True)

    file_id: uuid.UUID
    size_bytes: int
    sha256: str | None
    crc64nvme: str | None


class _Range(BaseModel):
    model_config = ConfigDict(frozen=True)

    number: int


class PartialFile:
    """A file being downloaded to `target`. Safe to share between threads."""

    def __init__(self, link: DownloadLink, target: Path, *, overwrite: bool) -> None:
        """Open the temporary file, and take up what an earlier run left.

        Raises:
            DestinationRefused: another process is at it, or it cannot be written.
        """
        self.link = link
        self.target = target
        self.size_bytes = link.size_bytes
        self.fetched_bytes = 0
        self.ended = False
        self._overwrite = overwrite
        self._part = partial_path(target, PART_SUFFIX)
        self._journal_file = partial_path(target, JOURNAL_SUFFIX)
        self._lock = threading.Lock()
        self._hashing = threading.Lock()
        self._hashed_to = 0
        self._checksum: Checksum = hashlib.sha256() if link.sha256 else Crc64Hash()
        self._left = 1  # the asking for ranges itself
        self._handle = _open_locked(self._part)
        self._done = self._resume()

    def _resume(self) -> set[int]:
        head = _Head.model_validate(self.link, from_attributes=True)
        done = _read_journal(self._journal_file, head)
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
        if not done:
            with contextlib.suppress(FileNotFoundError):
                self._journal_file.unlink()
            os.ftruncate(self._handle, 0)
        self._journal = os.open(self._journal_file, flags, 0o600) if self.size_bytes > RANGE_BYTES else -1
        if not done:
            self._write_down(head)
        os.ftruncate(self._handle, self.size_bytes)
        return done

    def missing(self) -> Iterator[tuple[int, int, int]]:
        """Yield (number, first, last) of the ranges that are not there, both ends inclusive."""
        for number, first in enumerate(range(0, self.size_bytes, RANGE_BYTES)):
            if number not in self._done:
                yield number, first, min(first + RANGE_BYTES, self.size_bytes) - 1

    def stored_bytes(self) -> int:
        """Return how many bytes an earlier run left."""
        return sum(min(RANGE_BYTES, self.size_bytes - number * RANGE_BYTES) for number in self._done)

    def add_range(self) -> None:
        """Count one more range to be fetched."""
        with self._lock:
            self._left += 1

    def part_done(self) -> bool:
        """Count one range (or the asking) as over; return True for the last of all."""
        with self._lock:
            self._left -= 1
            return self._left == 0

    def end(self) -> bool:
        """End this download; return False when it had ended already."""
        with self._lock:
            first, self.ended = not self.ended, True
        return first

    def write(self, offset: int, data: bytes) -> None:
        """Write bytes at their place.

        Raises:
            DiskFull: there is no room.
        """
        view = memoryview(data)
        while view:
            try:
                written = os.pwrite(self._handle, view, offset)
            except OSError as error:
                raise self._no_room(error) from None
            view, offset = view[written:], offset + written

    def arrived(self, number: int, size_bytes: int) -> None:
        """Note that a range is there."""
        with self._lock:
            self._done.add(number)
            self.fetched_bytes += size_bytes
            if self._journal >= 0:
                self._write_down(_Range(number=number))

    def hash_ready(self, check: Callable[[], None]) -> None:
        """Take what has arrived in order into the checksum, unless another thread is at it."""
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
        _begin_to_write(self._handle, end - RANGE_BYTES, RANGE_BYTES)

    def finish(self, check: Callable[[], None]) -> None:
        """Verify the whole, force it to disk, and give it its name. Only once every range is there.

        Raises:
            VerifyFailed: the bytes are not the promised ones; they are removed.
            DestinationDiffers: something has come to be at the target meanwhile.
            DiskFull: there is no room.
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

    def _write_down(self, line: BaseModel) -> None:
        if self._journal >= 0:
            try:
                os.write(self._journal, line.model_dump_json().encode() + b"\n")
            except OSError as error:
                raise self._no_room(error) from None

    def _no_room(self, error: OSError) -> DiskFull:
        return DiskFull(path=str(self.target), reason=error.strerror or str(error))


def _begin_to_write(handle: int, offset: int, length: int) -> None:
    """Have the system begin to bring a range to disk, where it has a word for that: then the last fsync waits less."""
    if sys.platform == "linux":
        os.posix_fadvise(handle, max(0, offset), length, os.POSIX_FADV_DONTNEED)


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
        os.close(handle)  # whoever had it has finished it meanwhile


def _read_journal(file: Path, head: _Head) -> set[int]:
    try:
        lines = file.read_bytes().rpartition(b"\n")[0].splitlines()
        if not lines or _Head.model_validate_json(lines[0]) != head:
            return set()
        return {_Range.model_validate_json(line).number for line in lines[1:]}
    except (OSError, ValidationError):
        return set()
