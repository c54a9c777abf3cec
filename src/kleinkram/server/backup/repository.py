"""A repository: contents by their SHA-256, each once, and snapshots that name them.

    klein-backup.json      format, id, and where it is sealed its key under the passphrase
    data/ab/ab12...        a content; its name is its SHA-256, or where sealed an HMAC of that
    snapshots/ID.json      a backup; written last, so that it names nothing that is not there
    locks/, unfinished/    who is at work; what was being written

Whatever is read is compared with its SHA-256; nothing is ever rewritten.
"""

import asyncio
import hashlib
import json
import re
import secrets
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, asynccontextmanager
from pathlib import Path

import zstandard
from pydantic import ValidationError

from kleinkram.server.backup.bucket import open_bucket
from kleinkram.server.backup.failing import CannotBeMeant, Damaged, InTheWay, NothingThere, NotOpened
from kleinkram.server.backup.names import Names
from kleinkram.server.backup.pace import Pace
from kleinkram.server.backup.sealing import Seal, new_key, open_key, sealed_size
from kleinkram.server.backup.shelf import FolderShelf, Item, Shelf
from kleinkram.server.backup.snapshot import FORMAT, Piece, Snapshot

_ABOUT = "klein-backup.json"
_DATA = "data/"
_SNAPSHOTS = "snapshots/"
_LEVEL = 3
# What may lie where somebody who began there was killed. All else is somebody else's.
_LEFT_BEHIND = re.compile(r"lock|locks/[a-z]+-[0-9a-f]{16}|unfinished/[0-9a-f]{32}")


class Repository:
    """Backups in one place. `seal` is None where they lie open."""

    def __init__(self, shelf: Shelf, seal: Seal | None) -> None:
        self.shelf = shelf
        self._seal = seal

    @property
    def is_sealed(self) -> bool:
        """Whether its files tell nothing to whoever has not the passphrase."""
        return self._seal is not None

    def name(self, sha256: bytes) -> bytes:
        """Return the name that a content has here."""
        return bytes.fromhex(self._seal.name(sha256)) if self._seal else sha256

    def stored_size(self, size_bytes: int) -> int:
        """Return how many bytes a content of so many takes here."""
        return sealed_size(size_bytes) if self._seal else size_bytes

    def path(self, name: bytes) -> str:
        """Return where the content of a name lies."""
        return f"{_DATA}{name.hex()[:2]}/{name.hex()}"

    async def held(self) -> Names:
        """Return what is here, and how large it is."""
        names = Names()
        async for item in self.shelf.listed(_DATA):
            name = item.path.rpartition("/")[2]
            if len(name) == 64:
                names.append(bytes.fromhex(name), item.size_bytes)
        return names

    async def put(self, sha256: bytes, size_bytes: int, pieces: AsyncIterator[bytes]) -> None:
        """Keep a content that `pieces` yields; where it raises, as it must on other bytes than these, none is kept."""
        path = self.path(self.name(sha256))
        if self._seal is None:
            await self.shelf.put(path, pieces, size_bytes)
            return
        async with aclosing(self._seal.seal(pieces, path)) as sealed:
            await self.shelf.put(path, sealed, self.stored_size(size_bytes))

    async def read(self, sha256: bytes) -> AsyncGenerator[bytes, None]:
        """Yield a content; what it was is only sure once the end is reached.

        Raises:
            FileNotFoundError: it is not here.
            Damaged: it is not what was kept, told at its end.
        """
        digest = hashlib.sha256()
        async with aclosing(self._opened(self.path(self.name(sha256)))) as pieces:
            async for piece in pieces:
                await asyncio.to_thread(digest.update, piece)
                yield piece
        if digest.digest() != sha256:
            raise Damaged(
                f"{self.path(self.name(sha256))} does not hold what its name says: it was changed or cut off."
            )

    async def verify(self, name: bytes, pace: Pace) -> None:
        """Read what has a name through.

        Raises:
            FileNotFoundError: it is not here.
            Damaged: its bytes are not those that have this name.
        """
        digest, path = hashlib.sha256(), self.path(name)
        async with aclosing(self._opened(path)) as pieces:
            async for piece in pace.slowed(pieces):
                await asyncio.to_thread(digest.update, piece)
        if self.name(digest.digest()) != name:
            raise Damaged(f"{path} does not hold what its name says: it was changed or cut off.")

    async def _opened(self, path: str) -> AsyncGenerator[bytes, None]:
        async with aclosing(self.shelf.read(path)) as pieces:
            if self._seal is None:
                async for piece in pieces:
                    yield piece
                return
            async with aclosing(self._seal.unseal(pieces, path)) as opened:
                async for piece in opened:
                    yield piece

    async def put_packed(self, raw: bytes) -> Piece:
        """Pack some bytes, keep them, and return by which name."""
        packed = await asyncio.to_thread(zstandard.ZstdCompressor(level=_LEVEL).compress, raw)
        sha256 = hashlib.sha256(packed)
        await self.put(sha256.digest(), len(packed), _just(packed))
        return Piece(sha256=sha256.hexdigest(), size_bytes=len(packed))

    async def read_packed(self, piece: Piece) -> bytes:
        """Return what was packed.

        Raises:
            Damaged: it is not here, or not what was kept.
        """
        sha256 = bytes.fromhex(piece.sha256)
        try:
            packed = b"".join([each async for each in self.read(sha256)])
        except FileNotFoundError:
            raise Damaged(f"{self.path(self.name(sha256))} is missing.") from None
        return await asyncio.to_thread(zstandard.ZstdDecompressor().decompress, packed)

    async def put_snapshot(self, snapshot: Snapshot) -> None:
        """Make a backup exist: all that it names is on the disk before."""
        await self.shelf.settle()
        body = snapshot.model_dump_json().encode()
        document = hashlib.sha256(body).hexdigest().encode() + b"\n" + body
        path = f"{_SNAPSHOTS}{snapshot.id}.json"
        pieces = self._seal.seal(_just(document), path) if self._seal else _just(document)
        await self.shelf.put(path, pieces, self.stored_size(len(document)))
        await self.shelf.settle()

    async def snapshot_ids(self) -> list[str]:
        """Return the names of all backups, the oldest first."""
        items: list[Item] = [item async for item in self.shelf.listed(_SNAPSHOTS)]
        return sorted(item.path.removeprefix(_SNAPSHOTS).removesuffix(".json") for item in items)

    async def snapshot(self, snapshot_id: str | None) -> Snapshot:
        """Return one backup, the latest where none is named.

        Raises:
            NothingThere: there is none, or none of that name.
            Damaged: its document was changed or cut off.
        """
        ids = await self.snapshot_ids()
        if snapshot_id is None and not ids:
            raise NothingThere(f"{self.shelf.name} holds no whole backup yet.")
        chosen = snapshot_id or ids[-1]
        if chosen not in ids:
            raise NothingThere(f"{self.shelf.name} holds no backup {chosen}: `klein backup list` shows what it holds.")
        path = f"{_SNAPSHOTS}{chosen}.json"
        try:
            document = b"".join([each async for each in self._opened(path)])
            stated, _, body = document.partition(b"\n")
            if hashlib.sha256(body).hexdigest().encode() != stated:
                raise Damaged(f"{path} was changed or cut off.")
            return Snapshot.model_validate_json(body)
        except FileNotFoundError:
            raise NothingThere(f"{path} went meanwhile.") from None
        except ValidationError as error:
            raise Damaged(f"{path} cannot be understood: a later Kleinkram may have written it ({error}).") from None

    async def forget_snapshot(self, snapshot_id: str) -> None:
        """Drop a backup's document; what only it named is for `forgetting` to remove."""
        await self.shelf.delete(f"{_SNAPSHOTS}{snapshot_id}.json")


@asynccontextmanager
async def open_place(address: str) -> AsyncGenerator[Shelf, None]:
    """Open a folder or `s3://bucket/prefix`, whatever is in it."""
    if address.startswith("s3://"):
        async with open_bucket(address) as shelf:
            yield shelf
    else:
        yield FolderShelf(Path(address))


async def open_repository(shelf: Shelf, passphrase: str | None) -> Repository:
    """Open the backups in a place.

    Raises:
        NothingThere: there are none.
        NotOpened: they are sealed, and this is not their passphrase.
    """
    about = await _read_about(shelf)
    if about is None:
        raise NothingThere(f"There are no backups in {shelf.name}.")
    if about["key"] is None:
        return Repository(shelf, None)
    if passphrase is None:
        raise NotOpened(
            f"The backups in {shelf.name} are sealed: give --passphrase-file, or set KLEINKRAM_BACKUP_PASSPHRASE."
        )
    return Repository(shelf, await asyncio.to_thread(open_key, str(about["key"]), passphrase))


async def make_repository(shelf: Shelf, passphrase: str | None, *, sealed: bool) -> Repository:
    """Open the backups in a place, or begin them there, `sealed` with a passphrase. The caller is alone there.

    Raises:
        CannotBeMeant: they are to be sealed, and there is no passphrase, or they lie open.
        InTheWay: there is something else.
    """
    about = await _read_about(shelf)
    if about is not None:
        if sealed and about["key"] is None:
            raise CannotBeMeant(
                f"The backups in {shelf.name} were begun without --encrypt: name another place for sealed ones."
            )
        return await open_repository(shelf, passphrase)
    async for item in shelf.listed(""):
        if not _LEFT_BEHIND.fullmatch(item.path):
            raise InTheWay(f"{shelf.name} is not empty and holds no backups (there is {item.path}): name an empty one.")
    if sealed and not passphrase:
        raise CannotBeMeant("--encrypt needs a passphrase: give --passphrase-file, or KLEINKRAM_BACKUP_PASSPHRASE.")
    seal, key = await asyncio.to_thread(new_key, passphrase) if sealed and passphrase else (None, None)
    document = json.dumps({"format": FORMAT, "id": secrets.token_hex(8), "key": key}).encode()
    await shelf.put(_ABOUT, _just(document), len(document))
    await shelf.settle()
    return Repository(shelf, seal)


async def _read_about(shelf: Shelf) -> dict[str, object] | None:
    try:
        raw = b"".join([each async for each in shelf.read(_ABOUT)])
    except FileNotFoundError:
        return None
    try:
        about = dict(json.loads(raw))
        if about["format"] != FORMAT:
            raise CannotBeMeant(f"The backups in {shelf.name} are of a later Kleinkram: use that, or a later one.")
        return {"key": about["key"]}
    except (ValueError, KeyError, TypeError):
        raise Damaged(f"{_ABOUT} in {shelf.name} cannot be understood: put it back from a copy.") from None


async def _just(body: bytes) -> AsyncGenerator[bytes, None]:
    yield body
