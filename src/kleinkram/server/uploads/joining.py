"""What the store does at the end of uploads: it joins their parts, and says whether the whole is what was announced."""

import asyncio
import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.errors import ChecksumMismatch, KleinkramError, UploadGone, UploadIncomplete
from kleinkram.contract.uploads import ChecksumKind
from kleinkram.server.storage import Storage, StoreMissing, StoreRefused
from kleinkram.server.uploads.signing_parts import expected_part_bytes, is_multipart

_AT_ONCE = 16
_LISTING_WORTH = 4

Failures = dict[uuid.UUID, KleinkramError]


async def join_at_store(storage: Storage, rows: Sequence[Row[Any]]) -> Failures:
    """Join the parts of each upload, and look at what came; return those that failed, and why."""
    gate = asyncio.Semaphore(_AT_ONCE)

    async def join(row: Row[Any]) -> tuple[uuid.UUID, KleinkramError | None]:
        async with gate:
            return row.id, await _join_parts(storage.proving_by(ChecksumKind(row.checksum)), row)

    failures = await _find_whole(storage, [row for row in rows if not is_multipart(row)])
    for upload_id, error in await asyncio.gather(*(join(row) for row in rows if is_multipart(row))):
        if error is not None:
            failures[upload_id] = error
    return failures


async def _find_whole(storage: Storage, rows: Sequence[Row[Any]]) -> Failures:
    """Find files of one part: their address was signed for one checksum, so what is there is what was named."""
    sizes: dict[str, int] = {}
    by_prefix: dict[str, list[Row[Any]]] = {}
    for row in rows:
        by_prefix.setdefault(row.key.split("/")[0] + "/", []).append(row)
    for prefix, group in by_prefix.items():
        if len(group) >= _LISTING_WORTH:
            sizes |= await storage.sizes(prefix)
        else:
            for row in group:
                found = await storage.find(row.key)
                sizes |= {row.key: found.size_bytes} if found else {}
    return {
        row.id: UploadIncomplete(path=row.path, reason="the file has not arrived")
        for row in rows
        if sizes.get(row.key) != row.size_bytes
    }


async def _join_parts(storage: Storage, row: Row[Any]) -> KleinkramError | None:
    held = await storage.held_parts(row.key, row.multipart_id) if row.multipart_id else []
    if held is not None:
        count = -(-row.size_bytes // row.part_size_bytes)
        good = {part.number for part in held if part.size_bytes == expected_part_bytes(row, part.number)}
        missing = sorted(set(range(1, count + 1)) - good)
        # While another hand joins them, the store may list fewer: then what it made is looked at below.
        if missing and await storage.find(row.key) is None:
            return UploadIncomplete(path=row.path, reason=f"{len(missing)} of {count} parts, the first is {missing[0]}")
        try:
            if not missing:
                await storage.complete_multipart(row.key, row.multipart_id, crc64nvme=row.crc64nvme)
        except StoreMissing:
            pass  # completed by another hand; what it made is looked at below
        except StoreRefused as refusal:
            if refusal.is_digest:
                return ChecksumMismatch(path=row.path, reason=str(refusal))
            return UploadIncomplete(path=row.path, reason=str(refusal))
    stored = await storage.find(row.key)
    if stored is None:
        return UploadGone(upload_id=str(row.id))
    if stored.size_bytes != row.size_bytes or stored.crc64nvme not in {None, row.crc64nvme}:
        return ChecksumMismatch(path=row.path, reason="the store's own checksum of the whole differs")
    return None
