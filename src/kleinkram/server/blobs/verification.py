"""Reading an object once, from its first byte to its last: its checksums, for us and for whoever reads along.

Holds one piece of the object at a time.
"""

import asyncio
import hashlib
import os
import time
import uuid
from collections.abc import Awaitable, Callable
from contextlib import aclosing
from dataclasses import dataclass

from aiohttp import ClientPayloadError

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.uploads import crc64nvme
from kleinkram.server.blobs.queries import BlobRow
from kleinkram.server.context import AppContext
from kleinkram.server.s3.client import S3Error
from kleinkram.server.s3.storage import Storage, StoreRefused

# Read once more where reading stopped.
_RETRIED_BYTES = 64 * 1024
_CONTROL_BYTES = 1024
Along = Callable[[bytes], Awaitable[None]]


@dataclass(frozen=True)
class ObjectChecksums:
    """Result of reading an object completely."""

    size_bytes: int
    sha256: bytes
    md5: bytes
    crc64nvme: bytes

    def differs_from(self, row: BlobRow) -> str | None:
        """Say how it differs from what was kept, or None."""
        if self.size_bytes != row.size_bytes:
            return f"it has {self.size_bytes} bytes, and came with {row.size_bytes}"
        if row.crc64nvme is not None and self.crc64nvme != row.crc64nvme:
            return f"its CRC-64/NVME is {self.crc64nvme.hex()}, and was {row.crc64nvme.hex()} when it came"
        if self.sha256 != row.sha256:
            return f"its sha256 is {self.sha256.hex()}, and was {row.sha256.hex()} by the word of its uploader"
        return None


class Unreadable(Exception):
    """The store serves other objects, and fails to return the bytes of this one; says from which byte on."""


async def read_through(context: AppContext, key: str, along: Along | None = None) -> ObjectChecksums:
    """Read an object at the rate that the settings allow, and give each piece to `along` too.

    Raises:
        FileNotFoundError: the store does not have it.
        Unreadable: the store fails at this object alone.
        StoreUnavailable: the store is away, or was while the object was read.
    """
    sha256, md5, crc, size_bytes = hashlib.sha256(), hashlib.md5(usedforsecurity=False), 0, 0
    started = time.monotonic()
    try:
        async with aclosing(context.storage.read(key, attempts=1)) as pieces:
            async for piece in pieces:
                size_bytes += len(piece)
                crc = await asyncio.to_thread(_digest, piece, sha256, md5, crc)
                if along is not None:
                    await along(piece)
                ahead_s = size_bytes / context.settings.verify_bytes_per_s - (time.monotonic() - started)
                if ahead_s > 0:
                    await asyncio.sleep(ahead_s)
    except StoreUnavailable as error:
        await _raise_if_unreadable(context.storage, key, size_bytes, error)
        raise
    return ObjectChecksums(size_bytes, sha256.digest(), md5.digest(), crc.to_bytes(8, "big"))


def _digest(piece: bytes, sha256: "hashlib._Hash", md5: "hashlib._Hash", crc: int) -> int:
    sha256.update(piece)
    md5.update(piece)
    return int(crc64nvme(piece, crc))


async def _raise_if_unreadable(storage: Storage, key: str, offset: int, error: StoreUnavailable) -> None:
    """Find out whether the store fails at one object: reading it stopped at `offset`, for the reason in `error`.

    A damaged object costs a store long: SeaweedFS 4.48 tries for 13 s before it answers 500. So it is read once more,
    from where reading stopped.

    Raises:
        Unreadable: it does.
        StoreUnavailable: the store is away.
    """
    if not isinstance(error.__cause__, ClientPayloadError) and not _is_failure(error):
        return
    try:
        await storage.read_range(key, offset=offset, size_bytes=_RETRIED_BYTES, attempts=1)
    except StoreUnavailable as again:
        if not _is_failure(again):
            return
        await _read_control(storage)
        why = f"the store does not return its bytes from {offset:,} on, and serves others ({again.reason})"
        raise Unreadable(why) from again


def _is_failure(error: StoreUnavailable) -> bool:
    """Say whether the store itself answered that it failed: a connection that breaks off may be the network's fault."""
    return isinstance(error.__cause__, S3Error) and error.__cause__.status == 500


async def _read_control(storage: Storage) -> None:
    """Write, read and remove an object: a store that cannot do that is in trouble as a whole.

    Raises:
        StoreUnavailable: it cannot.
    """
    key, body = f"probe/{uuid.uuid4()}", os.urandom(_CONTROL_BYTES)
    try:
        await storage.put_object(key, body)
        if await storage.read_range(key, offset=0, size_bytes=_CONTROL_BYTES) != body:
            raise StoreUnavailable(reason="it returns other bytes than were written")
    except (FileNotFoundError, StoreRefused) as error:
        raise StoreUnavailable(reason=f"it does not keep what is written: {error}") from error
    finally:
        await storage.delete(key)
