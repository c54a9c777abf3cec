"""Temporary copies of remote or decompressed files: bounded in size, and always removed.

SQLite reads any page at any time, so a database that comes over a network or out of a decompressor is written to a
temporary file first. The file is locked while it is used; the next reader removes the files of a killed one.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from kleinkram.recordings.errors import RecordingError, SourceError
from kleinkram.recordings.limits import WINDOW

MAX_SPOOL_BYTES = 64 * 2**30  # bytes of one database that are written to a temporary file
MIN_FREE_DISK_BYTES = 2**30  # bytes of the disk that a temporary file leaves to others

_PREFIX = "kleinkram-spool-"
_NEW_S = 60


class TooLarge(RecordingError):
    """A copy does not fit into the temporary folder. Internal to `recordings`."""


@contextmanager
def temporary_database(
    read: Callable[[int], bytes], logs: Mapping[str, Callable[[int], bytes]], *, max_bytes: int = MAX_SPOOL_BYTES
) -> Iterator[Path]:
    """Write a database and, by their suffixes, its log and journal to temporary files; yield the database's path."""
    with ExitStack() as stack:
        path = stack.enter_context(temporary_copy(read, max_bytes=max_bytes))
        for suffix, read_log in logs.items():
            stack.enter_context(temporary_copy(read_log, max_bytes=max_bytes, beside=(path, suffix)))
        yield path


@contextmanager
def temporary_copy(
    read: Callable[[int], bytes], *, max_bytes: int = MAX_SPOOL_BYTES, beside: tuple[Path, str] | None = None
) -> Iterator[Path]:
    """Write what `read` returns to a temporary file, which is removed afterwards; `beside`: at this path and suffix."""
    folder = Path(tempfile.gettempdir())
    _remove_abandoned(folder)
    if beside is None:
        descriptor, name = tempfile.mkstemp(prefix=_PREFIX, dir=folder)
    else:
        name = f"{beside[0]}{beside[1]}"
        descriptor = os.open(name, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    path = Path(name)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # SQLite writes what is in a log into the database as well.
        copies = 1 if beside is None else 2
        free = (shutil.disk_usage(folder).free - MIN_FREE_DISK_BYTES) // copies
        left = min(max_bytes, free)
        while data := read(WINDOW):
            left -= len(data)
            if left < 0:
                raise too_large(max_bytes, free)
            _write(descriptor, data, folder)
        yield path
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)


def _write(descriptor: int, data: bytes, folder: Path) -> None:
    try:
        with memoryview(data) as rest:
            written = 0
            while written < len(rest):
                written += os.write(descriptor, rest[written:])
    except OSError as error:
        raise SourceError(f"{folder}: a temporary copy cannot be written: {error.strerror}") from error


def too_large(max_bytes: int, free: int) -> TooLarge:
    """Return the error for a copy that is larger than allowed, or than the disk has room for."""
    if free < max_bytes:
        return TooLarge(
            f"it must be copied to {tempfile.gettempdir()} to be read, where {max(0, free)} bytes may be used; "
            "free some space, or set TMPDIR to a larger disk"
        )
    return TooLarge(f"a copy of it would have more than {max_bytes} bytes; fetch the file and inspect it locally")


def _remove_abandoned(folder: Path) -> None:
    """Remove copies of dead readers: those without a lock."""
    for path in folder.glob(f"{_PREFIX}*"):
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
        except OSError:
            continue  # gone by now, or of another user
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(descriptor).st_mtime < time.time() - _NEW_S:
                path.unlink(missing_ok=True)
        except OSError:
            continue  # in use
        finally:
            os.close(descriptor)
