"""Where backups lie: files by path, each written whole or not at all. A folder here; `bucket` is the other kind.

Nothing is ever written twice under another content, and nothing is held in memory but a piece at a time.
"""

import asyncio
import contextlib
import errno
import os
import uuid
from collections.abc import AsyncGenerator, AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from kleinkram.server.backup.failing import CannotWrite, Damaged

PIECE_BYTES = 1024 * 1024
_UNFINISHED = "unfinished"
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})


@dataclass(frozen=True)
class Item:
    """A file that lies there; `at` is when it was written, in seconds by the clock of the place itself."""

    path: str
    size_bytes: int
    at: float


class Shelf(Protocol):
    """What both kinds of places can do. Paths are relative, with slashes, of plain letters."""

    @property
    def name(self) -> str:
        """The place, as whoever named it wrote it."""

    async def put(self, path: str, pieces: AsyncIterator[bytes], size_bytes: int) -> None:
        """Write a file whole, or not at all where `pieces` raises; `size_bytes` is what is expected to come.

        Raises:
            CannotWrite: it is full, read-only or gone.
        """

    def read(self, path: str) -> AsyncGenerator[bytes, None]:
        """Yield a file in pieces of at most 1 MiB.

        Raises:
            FileNotFoundError: there is none.
        """

    def listed(self, prefix: str) -> AsyncGenerator[Item, None]:
        """Yield the files whose paths begin with `prefix` (whole folders, ending in a slash), sorted by path."""

    async def delete(self, path: str) -> None:
        """Remove a file; nothing happens where there is none."""

    async def settle(self) -> None:
        """Return when all that was written outlives a power cut."""

    async def tidy(self) -> None:
        """Remove what interrupted writes left, in a place that is known to be for backups; nobody may be writing."""


class FolderShelf:
    """A folder of a local or mounted disk, for this user alone."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._touched: set[Path] = set()

    @property
    def name(self) -> str:
        """The folder."""
        return str(self._root)

    async def put(self, path: str, pieces: AsyncIterator[bytes], size_bytes: int) -> None:
        """Write under another name, wait until the disk has it, then rename."""
        unfinished = self._root / _UNFINISHED / uuid.uuid4().hex
        with self._explained():
            descriptor = await asyncio.to_thread(_open, unfinished)
            try:
                async for piece in pieces:
                    await asyncio.to_thread(_write, descriptor, piece)
                await asyncio.to_thread(self._finish, descriptor, unfinished, self._root / path)
            except BaseException:
                unfinished.unlink(missing_ok=True)
                raise
            finally:
                os.close(descriptor)

    def _finish(self, descriptor: int, unfinished: Path, path: Path) -> None:
        os.fsync(descriptor)
        try:
            unfinished.rename(path)
        except FileNotFoundError:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._touched.update(path.parents[: len(path.relative_to(self._root).parents)])
            unfinished.rename(path)
        self._touched.add(path.parent)

    async def read(self, path: str) -> AsyncGenerator[bytes, None]:
        """Yield a file's bytes."""
        with self._explained():
            descriptor = await asyncio.to_thread(os.open, self._root / path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            while True:
                with self._explained():
                    piece = await asyncio.to_thread(os.read, descriptor, PIECE_BYTES)
                if not piece:
                    return
                yield piece
        finally:
            os.close(descriptor)

    async def listed(self, prefix: str) -> AsyncGenerator[Item, None]:
        """Yield files, folder by folder."""
        folder = self._root / prefix
        # What a run that was killed wrote there, who goes on from it takes for written: `settle` is to see to it.
        self._touched.update({folder, self._root})
        with self._explained():
            entries = await asyncio.to_thread(_entries, folder)
        for name, size_bytes, at in entries:
            if size_bytes is None:
                async for item in self.listed(f"{prefix}{name}/"):
                    yield item
            else:
                yield Item(f"{prefix}{name}", size_bytes, at)

    async def delete(self, path: str) -> None:
        """Remove a file."""
        with self._explained():
            (self._root / path).unlink(missing_ok=True)
        self._touched.add((self._root / path).parent)

    async def settle(self) -> None:
        """Write the folders' own entries."""
        touched, self._touched = self._touched, set()
        with self._explained():
            await asyncio.to_thread(_sync_folders, touched)

    async def tidy(self) -> None:
        """Remove unfinished files."""
        with self._explained():
            for name, size_bytes, _ in await asyncio.to_thread(_entries, self._root / _UNFINISHED):
                if size_bytes is not None:  # no folder is ours
                    (self._root / _UNFINISHED / name).unlink(missing_ok=True)

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        """Say what is wrong with the folder; a file that is not there is for the caller to name."""
        try:
            yield
        except FileNotFoundError:
            raise
        except OSError as error:
            if error.errno == errno.EIO:  # a bad spot of the disk costs the file that lies on it
                raise Damaged(f"A file in {self._root} cannot be read back or written: {error.strerror}.") from error
            if error.errno in _FULL:
                raise CannotWrite(
                    f"{self._root} is full: make room (`klein backup forget` drops old backups), then run it again; "
                    "what is there stays and is not copied twice."
                ) from error
            raise CannotWrite(f"{self._root} cannot be used: {error.strerror or error}.") from error


def _open(path: Path) -> int:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    try:
        return os.open(path, flags, 0o600)
    except FileNotFoundError:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        return os.open(path, flags, 0o600)


def _write(descriptor: int, piece: bytes) -> None:
    left = memoryview(piece)
    while left:
        left = left[os.write(descriptor, left) :]


def _entries(folder: Path) -> list[tuple[str, int | None, float]]:
    """Names in a folder with size and time, sorted; folders have no size. Empty where there is no folder."""
    found: list[tuple[str, int | None, float]] = []
    with contextlib.suppress(FileNotFoundError), os.scandir(folder) as entries:
        for entry in entries:
            with contextlib.suppress(FileNotFoundError):  # it went meanwhile, which says nothing of the others
                state = entry.stat()
                found.append((entry.name, None if entry.is_dir() else state.st_size, state.st_mtime))
    return sorted(found)


def _sync_folders(folders: set[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(FileNotFoundError):
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
