"""Copying objects out of the store, each read once, compared with its SHA-256 on the way, several side by side.

An object that is lost or differs is said and noted, and does not hold up the others; bytes that differ are kept as they
are. A store that is away is waited for.
"""

import asyncio
import hashlib
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterable
from contextlib import aclosing
from dataclasses import dataclass, field
from typing import TypeVar

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.server.backup.dumping import Wanted
from kleinkram.server.backup.failing import Unreachable
from kleinkram.server.backup.names import Names
from kleinkram.server.backup.pace import Pace
from kleinkram.server.backup.problems import Problems
from kleinkram.server.backup.repository import Repository
from kleinkram.server.backup.snapshot import ObjectEntry, ObjectList, Piece, Problem
from kleinkram.server.s3.storage import Storage

_LINES_BYTES = 4 * 1024 * 1024
_PAUSES_S = (1, 2, 4, 8, 15, 30, 30, 30, 30)
_READ_TRIES = 3
_Item = TypeVar("_Item")


class _Differs(Exception):
    """What came is not what was said; of the same bytes, read again, this would be right."""

    def __init__(self, sha256: bytes, size_bytes: int) -> None:
        super().__init__()
        self.sha256, self.size_bytes = sha256, size_bytes


class _Gone(Exception):
    """The store has no such object: not to be taken for a place that has lost a folder."""


@dataclass
class CopyCounts:
    """What has been done so far. `copied`: contents that were not there before."""

    objects: int = 0
    object_bytes: int = 0
    copied: int = 0
    copied_bytes: int = 0
    lost: int = 0
    corrupt: int = 0
    problems: Problems = field(default_factory=Problems)


class Lister:
    """Keeps the list of objects, piece by piece."""

    def __init__(self, repository: Repository, tally: CopyCounts) -> None:
        self._repository = repository
        self._tally = tally
        self._pieces: list[Piece] = []
        self._held = bytearray()

    async def add(self, entry: ObjectEntry) -> None:
        """Note one object."""
        tally = self._tally
        tally.objects += 1
        tally.object_bytes += entry.size_bytes
        tally.lost += entry.problem in ("lost", "unreadable")
        tally.corrupt += entry.problem == "corrupt"
        self._held += entry.model_dump_json(exclude_none=True).encode() + b"\n"
        if len(self._held) >= _LINES_BYTES:
            await self._flush()

    async def end(self) -> ObjectList:
        """Return where the list is."""
        await self._flush()
        tally = self._tally
        return ObjectList(
            count=tally.objects,
            size_bytes=tally.object_bytes,
            lost=tally.lost,
            corrupt=tally.corrupt,
            pieces=tuple(self._pieces),
        )

    async def _flush(self) -> None:
        if self._held:
            lines, self._held = bytes(self._held), bytearray()
            self._pieces.append(await self._repository.put_packed(lines))


@dataclass(frozen=True)
class Copier:
    """Copies objects from a store to a repository that holds `held` already."""

    storage: Storage
    repository: Repository
    held: Names
    pace: Pace
    tally: CopyCounts
    lister: Lister
    is_still_named: Callable[[str], Awaitable[bool]]
    check: Callable[[], None]

    async def copy(self, group: list[Wanted]) -> None:
        """Keep one content, and note all objects that have it."""
        self.check()
        first = group[0]
        if first.sha256 is not None and self._is_held(first.sha256, first.size_bytes):
            for each in group:
                await self._note(each, first.sha256, None)
            return
        kept: bytes | None = None
        found: list[tuple[bytes | None, Problem | None]] = []
        for each in group:
            # The same bytes, by another key, need not be read twice.
            found.append((kept, None) if kept else await self._fetch(each))
            kept = kept or (found[-1][0] if found[-1][0] == each.sha256 else None)
        for each, (sha256, problem) in zip(group, found, strict=True):
            await self._note(each, sha256 or kept, problem)

    def _is_held(self, sha256: bytes, size_bytes: int) -> bool:
        # A file whose size is another's is what a power cut left: it is written anew.
        held = self.held.size_bytes(self.repository.name(sha256))
        return held == self.repository.stored_size(size_bytes)

    async def _fetch(self, wanted: Wanted) -> tuple[bytes | None, Problem | None]:
        """Keep what a key holds; return its SHA-256, None where nothing could be had, and what is wrong."""
        try:
            try:
                return await self._keep(wanted.key, wanted.sha256, wanted.size_bytes), None
            except _Differs as actual:
                sha256 = await self._keep(wanted.key, actual.sha256, actual.size_bytes)
                return sha256, "corrupt" if wanted.sha256 is not None else None
        except _Gone:
            return None, "lost"
        except (_Differs, StoreUnavailable):  # another content each time it is read, or none
            return None, "unreadable"

    async def _keep(self, key: str, sha256: bytes | None, size_bytes: int) -> bytes:
        """Keep what a key holds, under the SHA-256 that it is said to have. Without one it is read for that first."""
        for left in reversed(range(_READ_TRIES)):
            try:
                if sha256 is None:
                    sha256, size_bytes = await self._hash(key)
                if self._is_held(sha256, size_bytes):
                    return sha256
                async with aclosing(self._verified(key, sha256, size_bytes)) as pieces:
                    await self.repository.put(sha256, size_bytes, pieces)
            except StoreUnavailable:  # noqa: PERF203  (a try is what this loop is about)
                await self._wait_for_store()
                if not left:
                    raise
            else:
                self.tally.copied += 1
                self.tally.copied_bytes += size_bytes
                return sha256
        raise AssertionError("unreachable")

    async def _verified(self, key: str, sha256: bytes, size_bytes: int) -> AsyncGenerator[bytes, None]:
        digest, count = hashlib.sha256(), 0
        async with aclosing(self._read(key)) as pieces:
            async for piece in self.pace.slowed(pieces):
                count += len(piece)
                if len(piece) > 65_536:
                    await asyncio.to_thread(digest.update, piece)
                else:
                    digest.update(piece)
                yield piece
        if digest.digest() != sha256 or count != size_bytes:
            raise _Differs(digest.digest(), count)

    async def _hash(self, key: str) -> tuple[bytes, int]:
        digest, count = hashlib.sha256(), 0
        async with aclosing(self._read(key)) as pieces:
            async for piece in pieces:
                digest.update(piece)
                count += len(piece)
        return digest.digest(), count

    async def _read(self, key: str) -> AsyncGenerator[bytes, None]:
        try:
            async with aclosing(self.storage.read(key)) as pieces:
                async for piece in pieces:
                    yield piece
        except FileNotFoundError:
            raise _Gone from None

    async def _wait_for_store(self) -> None:
        """Return once the store answers.

        Raises:
            Unreachable: it has not for minutes.
        """
        for pause_s in _PAUSES_S:
            try:
                await self.storage.check()
                return
            except StoreUnavailable:  # noqa: PERF203  (as above)
                await asyncio.sleep(pause_s)
        raise Unreachable("The store does not answer: run it again when it does; what was copied stays.")

    async def _note(self, wanted: Wanted, found: bytes | None, problem: Problem | None) -> None:
        if wanted.sha256 is None and found is None and not await self.is_still_named(wanted.key):
            return  # a piece of a log that was being let go just then
        if problem is not None:
            self.tally.problems.say(f"{wanted.key}: {problem}")
        await self.lister.add(
            ObjectEntry(
                key=wanted.key,
                size_bytes=wanted.size_bytes,
                sha256=found.hex() if found else None,
                expected=wanted.sha256.hex() if problem and wanted.sha256 else None,
                problem=problem,
            )
        )


async def side_by_side(
    items: AsyncIterator[_Item] | Iterable[_Item], work: Callable[[_Item], Awaitable[None]], at_once: int
) -> None:
    """Do `work` on all items, so many at once; the first failure ends all."""
    source = items if isinstance(items, AsyncIterator) else _each(items)
    turn = asyncio.Lock()

    async def go_on() -> None:
        while True:
            async with turn:
                try:
                    item = await anext(source)
                except StopAsyncIteration:
                    return
            await work(item)

    tasks = [asyncio.create_task(go_on()) for _ in range(at_once)]
    try:
        await asyncio.gather(*tasks)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _each(items: Iterable[_Item]) -> AsyncGenerator[_Item, None]:
    for item in items:
        yield item
