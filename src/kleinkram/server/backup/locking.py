"""Who is at work in a repository: many may read and add at once, who removes is alone.

In a folder the kernel keeps the lock, and gives it back however its holder ends. In a bucket everybody leaves a note,
renewed while they live; one that was not renewed for ten minutes of the store's own clock counts for nothing, and is
removed by whoever comes next. So who finds their own note gone was taken for gone, and does nothing more there.
"""

import asyncio
import contextlib
import errno
import fcntl
import os
import secrets
from collections.abc import AsyncGenerator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

from kleinkram.server.backup.failing import BackupError, CannotWrite, InTheWay, NothingThere, Unreachable
from kleinkram.server.backup.shelf import FolderShelf, Shelf

_NOTES = "locks/"
_RENEWED_EVERY_S = 60.0
_STALE_S = 600.0


class Presence:
    """Somebody at work in a place; in a bucket, `note` is how others know."""

    def __init__(self, shelf: Shelf, note: str | None = None) -> None:
        self._shelf = shelf
        self._note = note

    async def is_believed(self) -> bool:
        """Whether nobody took them for gone."""
        return self._note is None or self._note in {item.path async for item in self._shelf.listed(_NOTES)}

    async def confirm(self) -> None:
        """See that nobody took them for gone: before anything is said or removed that is not to be taken back.

        Raises:
            InTheWay: somebody did, as after ten minutes of silence, and may have changed what is there.
        """
        if not await self.is_believed():
            raise InTheWay(
                f"Nothing was heard of this for ten minutes (was the machine asleep?), so that somebody else may have "
                f"been at work on the backups in {self._shelf.name}: run it again, what was copied stays."
            )


@asynccontextmanager
async def at_work(shelf: Shelf, *, alone: bool, begins: bool = False) -> AsyncGenerator[Presence, None]:
    """Be at work in a place, `alone` or beside others; a folder is made for who `begins` there.

    Raises:
        InTheWay: somebody is there whom that does not suit.
        NothingThere: there is no such folder.
    """
    if isinstance(shelf, FolderShelf):
        with _held(Path(shelf.name), alone=alone, begins=begins):
            yield Presence(shelf)
        return
    async with _noted(shelf, alone=alone) as presence:
        yield presence


@contextlib.contextmanager
def _held(folder: Path, *, alone: bool, begins: bool) -> Iterator[None]:
    try:
        if begins:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        descriptor = _open(folder / "lock", alone=alone)
    except FileNotFoundError:
        raise NothingThere(f"There are no backups in {folder}: no such folder is there.") from None
    except OSError as error:
        raise CannotWrite(f"{folder} cannot be used: {error.strerror or error}.") from error
    try:
        try:
            fcntl.flock(descriptor, (fcntl.LOCK_EX if alone else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InTheWay(_busy(str(folder))) from None
        yield
    finally:
        os.close(descriptor)


def _open(path: Path, *, alone: bool) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        if alone or error.errno not in (errno.EROFS, errno.EACCES):
            raise
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC)  # who only reads may do so from where nobody can write


@asynccontextmanager
async def _noted(shelf: Shelf, *, alone: bool) -> AsyncGenerator[Presence, None]:
    own = f"{_NOTES}{'alone' if alone else 'beside'}-{secrets.token_hex(8)}"
    await shelf.put(own, _empty(), 0)
    try:
        notes = {item.path: item.at async for item in shelf.listed(_NOTES)}
        if own not in notes:
            raise Unreachable(f"{shelf.name} does not list what was just written there: it cannot hold backups.")
        others = [path for path, at in notes.items() if path != own and notes[own] - at < _STALE_S]
        if (alone and others) or any(path.startswith(f"{_NOTES}alone-") for path in others):
            raise InTheWay(_busy(shelf.name))
        for path in notes.keys() - {own, *others}:
            await shelf.delete(path)
        presence = Presence(shelf, own)
        renewing = asyncio.create_task(_renew(shelf, own, presence))
        try:
            yield presence
        finally:
            renewing.cancel()
            await asyncio.gather(renewing, return_exceptions=True)
    finally:
        await shelf.delete(own)


async def _renew(shelf: Shelf, own: str, presence: Presence) -> None:
    while True:
        await asyncio.sleep(_RENEWED_EVERY_S)
        with contextlib.suppress(BackupError):  # a place that stays away ends the work itself
            if not await presence.is_believed():
                return
            await shelf.put(own, _empty(), 0)


async def _empty() -> AsyncGenerator[bytes, None]:
    yield b""


def _busy(name: str) -> str:
    return f"Somebody else is at work on the backups in {name}: wait until that has ended, then run it again."
