"""A new file that appears under its name only when it is complete."""

from __future__ import annotations

import fcntl
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from kleinkram.recordings.errors import CannotWrite

if TYPE_CHECKING:
    from typing_extensions import Buffer

_WRITEBACK_BYTES = 32 * 2**20


@contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """Yield a stream whose content becomes the file `path` when the block ends without an error.

    Until then it is in `.NAME.part` beside it, which is removed after an error. One that a killed process left is
    written over. Once the name appears, content and name are on the disk.

    Raises:
        CannotWrite: the name exists, another process writes it, the folder cannot be written to, or the disk is full.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        refuse_existing(path)
        with _open_locked(path, part) as stream:
            try:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
                refuse_existing(path)
                part.rename(path)
            except BaseException:
                part.unlink(missing_ok=True)
                raise
        sync_folder(path.parent)
    except OSError as error:
        raise CannotWrite(str(path), f"cannot be written: {error.strerror or error}") from error


def refuse_existing(path: Path) -> None:
    """Raise CannotWrite if the name is taken."""
    if path.exists() or path.is_symlink():
        raise CannotWrite(str(path), "there is such a file or folder, and it is not replaced: choose another name")


def _open_locked(path: Path, part: Path) -> BinaryIO:
    descriptor = os.open(part, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    try:
        lock(descriptor, part)
        os.ftruncate(descriptor, 0)
    except BaseException as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError):
            raise CannotWrite(str(path), "another process is writing it") from None
        raise
    return io.BufferedWriter(_EarlyWriteback(descriptor, "wb"))


def lock(descriptor: int, path: Path) -> None:
    """Lock what was opened at a path, for one process, until it is closed.

    Raises:
        BlockingIOError: another process has it locked, or has removed or renamed it since it was opened.
    """
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with suppress(FileNotFoundError):
        if os.path.samestat(os.fstat(descriptor), path.lstat()):
            return
    raise BlockingIOError


class _EarlyWriteback(io.FileIO):
    """A file whose bytes go to the disk while it grows, so that the `fsync` at the end takes short."""

    _begun = _end = 0

    def write(self, data: Buffer) -> int:
        """Write bytes, and start writing back what has come since the last time."""
        written = super().write(data)
        self._end += written
        if self._end - self._begun >= _WRITEBACK_BYTES and hasattr(os, "posix_fadvise"):
            # The kernel writes pages that are to be dropped, without waiting, and keeps those that are dirty.
            os.posix_fadvise(self.fileno(), self._begun, self._end - self._begun, os.POSIX_FADV_DONTNEED)
            self._begun = self._end
        return written


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk, where the file system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
