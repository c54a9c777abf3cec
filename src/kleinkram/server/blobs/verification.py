"""Reads an object completely and computes its checksums; a parser may receive the same bytes.

Memory holds one piece of the object at a time.
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

_RETRY_BYTES = 64 * 1024  # read again where reading failed
_CONTROL_BYTES = 1024
ByteReceiver = Callable[[bytes], Awaitable[None]]


@dataclass(frozen=True)
class ObjectChecksums:
    """Result of reading an object completely."""

    size_bytes: int
    sha256: bytes
    md5: bytes
    crc64nvme: bytes

    def differs_from(self, row: BlobRow) -> str | None:
        """Return how the object differs from its row; None if it does not."""
        if self.size_bytes != row.size_bytes:
            return f"it has {self.size_bytes} bytes instead of {row.size_bytes}"
        if row.crc64nvme is not None and self.crc64nvme != row.crc64nvme:
            return f"its CRC-64/NVME is {self.crc64nvme.hex()} instead of {row.crc64nvme.hex()} at its upload"
        if self.sha256 != row.sha256:
            return f"its sha256 is {self.sha256.hex()} instead of {row.sha256.hex()} as stated by its uploader"
        return None


class Unreadable(Exception):
    """The store serves other objects but not the bytes of this one; the message names the first byte that failed."""


async def read_through(context: AppContext, key: str, receive: ByteReceiver | None = None) -> ObjectChecksums:
    """Read an object at the rate that the settings allow, and pass each piece to `receive`.

    Raises:
        FileNotFoundError: the store does not have it.
        Unreadable: the store fails at this object alone.
        StoreUnavailable: the store did not answer.
    """
    sha256, md5, crc, size_bytes = hashlib.sha256(), hashlib.md5(usedforsecurity=False), 0, 0
    started = time.monotonic()
    try:
        async with aclosing(context.storage.read(key, attempts=1)) as pieces:
            async for piece in pieces:
                size_bytes += len(piece)
                crc = await asyncio.to_thread(_digest, piece, sha256, md5, crc)
                if receive is not None:
                    await receive(piece)
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
    """Check whether the store fails only at this object, which it returned up to `offset` before `error`.

    Reads again from there only: with a damaged object, SeaweedFS 4.48 tries for 13 s before it answers 500.

    Raises:
        Unreadable: it does.
        StoreUnavailable: the store fails at other objects, too.
    """
    if not isinstance(error.__cause__, ClientPayloadError) and not _is_failure(error):
        return
    try:
        await storage.read_range(key, offset=offset, size_bytes=_RETRY_BYTES, attempts=1)
    except StoreUnavailable as again:
        if not _is_failure(again):
            return
        await _read_control(storage)
        message = f"the store does not return its bytes from {offset:,} on, but serves others ({again.reason})"
        raise Unreadable(message) from again


def _is_failure(error: StoreUnavailable) -> bool:
    """Whether the store itself answered with a failure; a broken connection may be the network's fault."""
    return isinstance(error.__cause__, S3Error) and error.__cause__.status == 500


async def _read_control(storage: Storage) -> None:
    """Write, read and remove a probe; raise StoreUnavailable if that fails: the store fails as a whole."""
    key, body = f"probe/{uuid.uuid4()}", os.urandom(_CONTROL_BYTES)
    try:
        await storage.put_object(key, body)
        if await storage.read_range(key, offset=0, size_bytes=_CONTROL_BYTES) != body:
            raise StoreUnavailable(reason="it returns other bytes than were written")
    except (FileNotFoundError, StoreRefused) as error:
        raise StoreUnavailable(reason=f"it does not keep what is written: {error}") from error
    finally:
        await storage.delete(key)
