"""Writes files so that they are complete after a kill at any moment. Imports only the standard library."""

import os
from pathlib import Path

_SHORT_BYTES = 128
_RESERVED_BYTES = 4096


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
