"""Reading an object once, from its first byte to its last: its checksums, for us and for whoever reads along.

Holds one piece of the object at a time.
"""

import asyncio
import hashlib
import time
from collections.abc import Awaitable, Callable
from contextlib import aclosing
from dataclasses import dataclass

from awscrt.checksums import crc64nvme
from sqlalchemy import Row

from kleinkram.server.site import Site

Along = Callable[[bytes], Awaitable[None]]


@dataclass(frozen=True)
class Found:
    """What reading an object through found."""

    size_bytes: int
    sha256: bytes
    md5: bytes
    crc64nvme: bytes

    def differs_from(self, row: Row[tuple[object, ...]]) -> str | None:
        """Say how it differs from what was kept, or None."""
        if self.size_bytes != row.size_bytes:
            return f"it has {self.size_bytes} bytes, and came with {row.size_bytes}"
        if row.crc64nvme is not None and self.crc64nvme != row.crc64nvme:
            return f"its CRC-64/NVME is {self.crc64nvme.hex()}, and was {row.crc64nvme.hex()} when it came"
        if self.sha256 != row.sha256:
            return f"its sha256 is {self.sha256.hex()}, and was {row.sha256.hex()} by the word of its uploader"
        return None


async def read_through(site: Site, key: str, along: Along | None = None) -> Found:
    """Read an object at the rate that the settings allow, and give each piece to `along` too.

    Raises:
        FileNotFoundError: the store does not have it.
        StoreUnavailable: the store did not give all of it.
    """
    sha256, md5, crc, size_bytes = hashlib.sha256(), hashlib.md5(usedforsecurity=False), 0, 0
    started = time.monotonic()
    async with aclosing(site.storage.read(key)) as pieces:
        async for piece in pieces:
            size_bytes += len(piece)
            crc = await asyncio.to_thread(_digest, piece, sha256, md5, crc)
            if along is not None:
                await along(piece)
            ahead_s = size_bytes / site.settings.proving_bytes_per_s - (time.monotonic() - started)
            if ahead_s > 0:
                await asyncio.sleep(ahead_s)
    return Found(size_bytes, sha256.digest(), md5.digest(), crc.to_bytes(8, "big"))


def _digest(piece: bytes, sha256: "hashlib._Hash", md5: "hashlib._Hash", crc: int) -> int:
    sha256.update(piece)
    md5.update(piece)
    return int(crc64nvme(piece, crc))
