"""Restoring a backup into an empty site: the objects first, then the database in one transaction.

So a site that was not restored to its end has an empty database, and shows nothing that it has not. A note in the
bucket says which backup is being restored, so that the same command goes on and no other begins.
"""

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import aclosing
from dataclasses import dataclass, field

import psycopg
from sqlalchemy.exc import SQLAlchemyError

from kleinkram.server.backup import loading
from kleinkram.server.backup.bucket import BucketShelf, open_site_bucket
from kleinkram.server.backup.copying import side_by_side
from kleinkram.server.backup.failing import CannotBeMeant, Damaged, InTheWay, Unreachable
from kleinkram.server.backup.loading import Missing, Target
from kleinkram.server.backup.locking import at_work
from kleinkram.server.backup.pace import Pace, amount, telling
from kleinkram.server.backup.repository import Repository, open_place, open_repository
from kleinkram.server.backup.snapshot import ObjectEntry, Piece, Snapshot
from kleinkram.server.settings import Settings, plain_dsn

_NOTE = ".kleinkram-restore"
_LOST, _CORRUPT = "lost", "corrupt"


@dataclass(frozen=True)
class Wish:
    """What is to be restored: the latest backup where none is named."""

    place: str
    snapshot_id: str | None
    passphrase: str | None
    bytes_per_s: float | None
    at_once: int
    quiet: bool


@dataclass
class Restored:
    """What was restored. `sent`: contents that were not there from an earlier try."""

    snapshot: Snapshot
    objects: int = 0
    object_bytes: int = 0
    sent: int = 0
    missing: list[Missing] = field(default_factory=list)


async def restore(settings: Settings, wish: Wish) -> Restored:
    """Fill the empty site that the settings name.

    Raises:
        BackupError: it could not be done; the site is still empty, and the same command goes on.
    """
    if settings.migration_database_url is None:
        raise CannotBeMeant("Restoring makes the schema: set KLEINKRAM_MIGRATION_DATABASE_URL, as for `migrate`.")
    target = Target(plain_dsn(settings.migration_database_url), settings.serving_role, settings.store_id)
    async with open_place(wish.place) as shelf, at_work(shelf, alone=False), open_site_bucket(settings) as bucket:
        repository = await open_repository(shelf, wish.passphrase)
        snapshot = await repository.snapshot(wish.snapshot_id)
        loading.refuse_unknown_schema(snapshot)
        try:
            return await _restore(repository, snapshot, bucket, target, wish)
        except (psycopg.Error, SQLAlchemyError) as error:
            reason = str(error).strip().partition("\n")[0]
            raise Unreachable(f"The database would not take it ({reason}): the site is still empty.") from error


async def _restore(
    repository: Repository, snapshot: Snapshot, bucket: BucketShelf, target: Target, wish: Wish
) -> Restored:
    filling = _Filling(repository, bucket, Pace(wish.bytes_per_s), Restored(snapshot))
    restored, total = filling.restored, snapshot.objects
    goes_on = await _claim(bucket, snapshot)
    before = await asyncio.to_thread(loading.restored_from, target)
    if before not in {None, snapshot.id} or (before and not goes_on):
        raise InTheWay(f"The database was restored from the backup {before} before: restore into an empty one.")
    filling.looks_first = goes_on

    def so_far() -> str:
        done = f"{amount(restored.object_bytes)} of {amount(total.size_bytes)}"
        return f"restore: {restored.objects} of {total.count} objects, {done}"

    async with telling(so_far, quiet=wish.quiet):
        await side_by_side(filling.entries(), filling.fill, wish.at_once)
        if before is None:
            loop = asyncio.get_running_loop()

            def read(piece: Piece) -> bytes:
                return asyncio.run_coroutine_threadsafe(repository.read_packed(piece), loop).result()

            await asyncio.to_thread(loading.load, target, snapshot, read, restored.missing)
    await bucket.delete(_NOTE)
    return restored


async def _claim(bucket: BucketShelf, snapshot: Snapshot) -> bool:
    """Note in the bucket what is being restored there; return whether an earlier try has noted the same.

    Raises:
        InTheWay: the bucket holds something else.
    """
    try:
        noted = json.loads(b"".join([each async for each in bucket.read(_NOTE)]))
    except FileNotFoundError:
        noted = None
    if noted is not None:
        if noted["snapshot"] != snapshot.id:
            raise InTheWay(
                f"A restore of the backup {noted['snapshot']} into {bucket.name} was not finished: go on with that one "
                "(--snapshot), or name an empty site."
            )
        return True
    async for item in bucket.listed(""):
        raise InTheWay(f"{bucket.name} is not empty (there is {item.path}): a backup is restored into an empty one.")
    body = json.dumps({"snapshot": snapshot.id}).encode()
    await bucket.put(_NOTE, _just(body), len(body))
    return False


async def _just(body: bytes) -> AsyncGenerator[bytes, None]:
    yield body


@dataclass
class _Filling:
    """Puts objects back. `looks_first`: some may be there already."""

    repository: Repository
    bucket: BucketShelf
    pace: Pace
    restored: Restored
    looks_first: bool = False

    async def entries(self) -> AsyncGenerator[ObjectEntry, None]:
        """Yield all objects of the backup."""
        for piece in self.restored.snapshot.objects.pieces:
            for line in (await self.repository.read_packed(piece)).splitlines():
                yield ObjectEntry.model_validate_json(line)

    async def fill(self, entry: ObjectEntry) -> None:
        """Put one object back, or note why it cannot be."""
        restored = self.restored
        restored.objects += 1
        restored.object_bytes += entry.size_bytes
        # What no backup held then, a later or an earlier one may have brought.
        sha256 = entry.sha256 or entry.expected
        if sha256 is None:
            return
        try:
            await self._put(entry.key, bytes.fromhex(sha256), entry.size_bytes)
        except FileNotFoundError:
            reason = "no backup holds its bytes" if entry.sha256 is None else "the backup it was restored from lacks it"
            restored.missing.append(Missing(entry.key, _LOST, reason))
        except Damaged:
            reason = "the backup it was restored from was damaged"
            restored.missing.append(Missing(entry.key, _LOST, reason))
        else:
            if entry.problem == _CORRUPT:
                reason = "it was found corrupt when it was backed up, and restored as it was"
                restored.missing.append(Missing(entry.key, _CORRUPT, reason))

    async def _put(self, key: str, sha256: bytes, size_bytes: int) -> None:
        if self.looks_first and await self.bucket.size_bytes(key) is not None:
            return  # it was put there whole
        async with aclosing(self.repository.read(sha256)) as pieces:
            await self.bucket.put(key, self.pace.slowed(pieces), size_bytes)
        self.restored.sent += 1
