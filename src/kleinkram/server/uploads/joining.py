"""What the store says of uploads: what it holds of small ones, and at the end whether all is there as announced."""

import asyncio
import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.errors import ChecksumMismatch, KleinkramError, UploadGone, UploadIncomplete
from kleinkram.contract.uploads import ChecksumKind, HeldPart
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
            return row.id, await _join_parts(storage.verifying_by(ChecksumKind(row.checksum)), row)

    failures = await _find_whole(storage, [row for row in rows if not is_multipart(row)])
    for upload_id, error in await asyncio.gather(*(join(row) for row in rows if is_multipart(row))):
        if error is not None:
            failures[upload_id] = error
    return failures


async def held_whole(storage: Storage, rows: Sequence[Row[Any]]) -> dict[uuid.UUID, list[HeldPart]]:
    """Return what the store holds of those that are files of one part: all of a file, as that part, or nothing."""
    held: dict[str, HeldPart] = {}
    signed = [row for row in rows if not is_multipart(row) and row.signed_checksum is not None]
    for prefix, group in _by_prefix(signed).items():
        for asked in [prefix] if len(group) >= _LISTING_WORTH else [row.key for row in group]:
            held |= await storage.held_objects(asked)
    return {row.id: [part] for row in signed if (part := held.get(row.key)) and part.size_bytes == row.size_bytes}


def _by_prefix(rows: Sequence[Row[Any]]) -> dict[str, list[Row[Any]]]:
    by_prefix: dict[str, list[Row[Any]]] = {}
    for row in rows:
        by_prefix.setdefault(row.key.split("/")[0] + "/", []).append(row)
    return by_prefix


async def _find_whole(storage: Storage, rows: Sequence[Row[Any]]) -> Failures:
    """Find files of one part: their address was signed for one checksum, so what is there is what was named."""
    sizes: dict[str, int] = {}
    for prefix, group in _by_prefix(rows).items():
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
    refusal = await _ask_to_join(storage, row)
    stored = await storage.find(row.key)
    if stored is None:
        return refusal
    # Several may join the same parts at once. What is there counts, not what one of them was told on the way.
    if stored.size_bytes != row.size_bytes or stored.crc64nvme not in {None, row.crc64nvme}:
        return ChecksumMismatch(path=row.path, reason="the store's own checksum of the whole differs")
    return None


async def _ask_to_join(storage: Storage, row: Row[Any]) -> KleinkramError:
    """Have the parts joined; return what it means if there is no object now."""
    held = await storage.held_parts(row.key, row.multipart_id) if row.multipart_id else []
    if held is None:
        return UploadGone(upload_id=str(row.id))
    count = -(-row.size_bytes // row.part_size_bytes)
    good = {part.number for part in held if part.size_bytes == expected_part_bytes(row, part.number)}
    missing = sorted(set(range(1, count + 1)) - good)
    if missing:
        return UploadIncomplete(path=row.path, reason=f"{len(missing)} of {count} parts, the first is {missing[0]}")
    try:
        await storage.complete_multipart(row.key, row.multipart_id, count=count, crc64nvme=row.crc64nvme)
    except StoreMissing:
        return UploadGone(upload_id=str(row.id))
    except StoreRefused as error:
        if error.is_digest:
            return ChecksumMismatch(path=row.path, reason=str(error))
        return UploadIncomplete(path=row.path, reason=str(error))
    return UploadGone(upload_id=str(row.id))
