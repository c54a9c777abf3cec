"""Dropping old backups, and what only they named. Whoever does it is alone in the place."""

from dataclasses import dataclass

from kleinkram.server.backup.failing import CannotBeMeant, Damaged
from kleinkram.server.backup.locking import at_work
from kleinkram.server.backup.repository import open_place, open_repository
from kleinkram.server.backup.verifying import Verified, mark


@dataclass(frozen=True)
class Forgotten:
    """Which backups went, which stay, and what was removed with those."""

    forgotten: tuple[str, ...]
    kept: tuple[str, ...]
    removed: int
    removed_bytes: int


async def forget(place: str, passphrase: str | None, *, keep: int) -> Forgotten:
    """Keep the latest `keep` backups and drop the others, then all contents that none names any more.

    Raises:
        CannotBeMeant: none is to be kept.
        InTheWay: somebody is at work there.
        Damaged: a backup that is kept cannot be read, so that nobody knows what it names; nothing was removed.
    """
    if keep < 1:
        raise CannotBeMeant("--keep must be at least 1: remove the folder itself where no backup is wanted.")
    async with open_place(place) as shelf, at_work(shelf, alone=True) as presence:
        repository = await open_repository(shelf, passphrase)
        await shelf.tidy()
        ids = await repository.snapshot_ids()
        old, kept = ids[:-keep], ids[-keep:]
        names = await repository.held()
        for snapshot_id in kept:
            try:
                await mark(repository, await repository.snapshot(snapshot_id), names, Verified())
            except Damaged as error:  # noqa: PERF203  (there are few)
                raise Damaged(f"Nothing was removed, since the backup {snapshot_id} cannot be read: {error}") from None
        # The documents first: what is left of a run that ended in between names nothing that is gone.
        for snapshot_id in old:
            await presence.confirm()
            await repository.forget_snapshot(snapshot_id)
        await shelf.settle()
        removed = removed_bytes = 0
        for name, size_bytes in names.unmarked():
            await presence.confirm()
            await shelf.delete(repository.path(name))
            removed, removed_bytes = removed + 1, removed_bytes + size_bytes
        await shelf.settle()
    return Forgotten(tuple(old), tuple(kept), removed, removed_bytes)
