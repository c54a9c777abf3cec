"""Files that survive a kill at any moment, and files that untrusted code wrote. Imports only the standard library."""

import contextlib
import errno
import os
import shutil
import stat
from pathlib import Path
from typing import IO

# Errors of a full disk or an exceeded quota.
DISK_FULL_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT})
_SHORT_BYTES = 128
_RESERVED_BYTES = 4096
# An empty file takes space, too: an entry of its directory and an inode.
_ENTRY_BYTES = 1024


def write_in_place(path: Path, text: str, *, create: bool = True) -> None:
    """Overwrite a short file, which needs no further disk space.

    Raises:
        OSError: it cannot be written, or does not exist and `create` is false.
    """
    descriptor = os.open(path, os.O_WRONLY | (os.O_CREAT if create else 0) | os.O_CLOEXEC, 0o600)
    try:
        # A single write of constant length is atomic.
        os.pwrite(descriptor, text.ljust(_SHORT_BYTES).encode(), 0)
    finally:
        os.close(descriptor)


def write_atomically(path: Path, text: str) -> None:
    """Replace a file of mode 0600; space that was reserved for it is used."""
    temporary = _temporary(path)
    with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600), "w") as stream:
        stream.write(text)
        stream.truncate()
        stream.flush()
        os.fsync(stream.fileno())
    temporary.replace(path)


def reserve(path: Path) -> None:
    """Reserve disk space for a later `write_atomically`.

    Raises:
        OSError: the disk is full.
    """
    with _temporary(path).open("wb") as stream:
        stream.write(bytes(_RESERVED_BYTES))
        stream.flush()
        os.fsync(stream.fileno())


def _temporary(path: Path) -> Path:
    return path.with_name(path.name + ".new")


def write_all(descriptor: int, data: bytes) -> None:
    """Write all bytes to a file.

    Raises:
        OSError: the disk is full.
    """
    while data:
        data = data[os.write(descriptor, data) :]


def remove_tree(directory: Path) -> None:
    """Remove a directory and its content, including directories without permissions for their owner.

    Raises:
        OSError: something cannot be removed, such as files of another user.
    """
    try:
        shutil.rmtree(directory)
    except FileNotFoundError:
        return
    except PermissionError:
        directory.chmod(0o700)
        for parent, names, _ in os.walk(directory):
            for name in names:
                # A link to a directory is listed as one, and is only removed.
                if not (Path(parent) / name).is_symlink():
                    (Path(parent) / name).chmod(0o700)
        shutil.rmtree(directory)


def open_beneath(directory: Path, relative: str) -> IO[bytes] | None:
    """Open a regular file below a directory that untrusted code wrote to; None where it does not exist.

    Raises:
        OSError: it is not a regular file, or a link is on the way.
    """
    *parents, name = relative.split("/")
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC
    current = os.open(directory, flags | os.O_DIRECTORY)
    try:
        for parent in parents:
            child = os.open(parent, flags | os.O_DIRECTORY, dir_fd=current)
            os.close(current)
            current = child
        descriptor = os.open(name, flags | os.O_NONBLOCK, dir_fd=current)
    except FileNotFoundError:
        return None
    finally:
        os.close(current)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(f"{name} is no regular file")
    return os.fdopen(descriptor, "rb")


def disk_usage_bytes(directory: Path) -> int:
    """Return the disk space of all entries below a directory; links are not followed."""
    total = 0
    pending = [str(directory)]
    while pending:
        # Entries may disappear meanwhile.
        with contextlib.suppress(OSError), os.scandir(pending.pop()) as entries:
            for entry in entries:
                total += entry.stat(follow_symlinks=False).st_blocks * 512 + _ENTRY_BYTES
                if entry.is_dir(follow_symlinks=False):
                    pending.append(entry.path)
    return total
