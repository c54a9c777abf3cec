"""Files written so that a kill at any moment leaves them whole, and read so that strangers' links lead nowhere."""

import errno
import os
import shutil
import stat
from pathlib import Path
from typing import IO

# What the kernel says where a disk, or what somebody may have of it, is full.
FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_SHORT_BYTES = 128


def write_over(path: Path, text: str, *, makes: bool = True) -> None:
    """Write a short file where it stands: once it is there, that takes no room of the disk.

    Raises:
        OSError: it cannot be written, or is not there and `makes` says that it is not to be made.
    """
    descriptor = os.open(path, os.O_WRONLY | (os.O_CREAT if makes else 0) | os.O_CLOEXEC, 0o600)
    try:
        # Of constant length, and one write: it is there as a whole or not at all.
        os.pwrite(descriptor, text.ljust(_SHORT_BYTES).encode(), 0)
    finally:
        os.close(descriptor)


def write_whole(path: Path, text: str) -> None:
    """Write a file of mode 0600 whole, or not at all."""
    unfinished = path.with_name(path.name + ".new")
    unfinished.unlink(missing_ok=True)
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "w") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(descriptor)
    unfinished.replace(path)


def remove_tree(folder: Path) -> None:
    """Remove a folder and all that is in it, though folders in it are closed to their owner.

    Raises:
        OSError: something stays, such as what belongs to somebody else.
    """
    try:
        shutil.rmtree(folder)
    except FileNotFoundError:
        return
    except PermissionError:
        folder.chmod(0o700)
        for here, folders, _ in os.walk(folder):
            for name in folders:
                # A link to a folder is listed as one, and is only removed.
                if not (Path(here) / name).is_symlink():
                    (Path(here) / name).chmod(0o700)
        shutil.rmtree(folder)


def open_inside(folder: Path, relative: str) -> IO[bytes] | None:
    """Open a file below a folder that a stranger writes to, without following a link; None where there is none.

    Raises:
        OSError: it is something else, or a link leads there.
    """
    *parents, name = relative.split("/")
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC
    here = os.open(folder, flags | os.O_DIRECTORY)
    try:
        for parent in parents:
            below = os.open(parent, flags | os.O_DIRECTORY, dir_fd=here)
            os.close(here)
            here = below
        descriptor = os.open(name, flags | os.O_NONBLOCK, dir_fd=here)
    except FileNotFoundError:
        return None
    finally:
        os.close(here)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(f"{name} is no regular file")
    return os.fdopen(descriptor, "rb")
