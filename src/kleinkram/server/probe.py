"""The start-up probe: find out how this store verifies what it receives, by trying to deceive it."""

import base64
import hashlib
import logging
import uuid
from collections.abc import AsyncIterator, Awaitable
from contextlib import asynccontextmanager

from awscrt.checksums import crc64nvme
from sqlalchemy import func
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.uploads import ChecksumKind
from kleinkram.server.db import Connection
from kleinkram.server.storage import CHECKSUM_HEADERS, Abilities, Storage, StoreMissing, StoreRefused
from kleinkram.server.tables import store_probe

_log = logging.getLogger("kleinkram.probe")
_BODY = b"kleinkram probes what this store verifies"
_OTHER = b"kleinkram probes what this store VERIFIES"


async def probe(storage: Storage) -> Abilities:
    """Return what the store can do: the strongest checksum it verifies, and whether it refuses to overwrite an object.

    Raises:
        StoreUnavailable: the store does not answer, or verifies nothing at all, so that nothing may be kept in it.
    """
    await storage.check()
    for kind in (ChecksumKind.crc64nvme, ChecksumKind.sha256, ChecksumKind.md5):
        if await _refuses_wrong(storage, kind) and await _verifies_parts(storage.verifying_by(kind)):
            return Abilities(kind, writes_once=await _writes_once(storage))
    raise StoreUnavailable(reason="it accepts bytes that differ from their checksum, so it cannot keep recordings safe")


async def _is_taken(asking: Awaitable[None]) -> bool:
    # Only the store's own refusal counts: one that does not answer has neither taken nor refused.
    try:
        await asking
    except StoreRefused:
        return False
    return True


async def _refuses_wrong(storage: Storage, kind: ChecksumKind) -> bool:
    key = f"probe/{uuid.uuid4()}"
    try:
        right = await _is_taken(storage.put_small(key, _BODY, _stated(kind, _BODY)))
        return right and not await _is_taken(storage.put_small(f"{key}-wrong", _BODY, _stated(kind, _OTHER)))
    finally:
        await storage.delete(key)
        await storage.delete(f"{key}-wrong")


async def _writes_once(storage: Storage) -> bool:
    key = f"probe/{uuid.uuid4()}"
    once = {"If-None-Match": "*"}
    try:
        # It may be there although refused: written by an earlier try, whose answer was lost.
        first = await _is_taken(storage.put_small(key, _BODY, once)) or await storage.find(key) is not None
        return first and not await _is_taken(storage.put_small(key, _BODY, once))
    finally:
        await storage.delete(key)


def _stated(kind: ChecksumKind, body: bytes) -> dict[str, str]:
    if kind is ChecksumKind.crc64nvme:
        digest = crc64nvme(body).to_bytes(8, "big")
    elif kind is ChecksumKind.sha256:
        digest = hashlib.sha256(body).digest()
    else:
        digest = hashlib.md5(body, usedforsecurity=False).digest()
    return {CHECKSUM_HEADERS[kind]: base64.b64encode(digest).decode()}


async def _verifies_parts(storage: Storage) -> bool:
    """Say whether wrong parts are refused and right ones joined: what holds for whole objects need not for parts."""
    try:
        return await _refuses_wrong_part(storage) and await _joins_right_part(storage)
    except StoreRefused:  # it opens no multipart upload with this checksum
        return False


async def _refuses_wrong_part(storage: Storage) -> bool:
    # In an upload of its own: a store may drop all of one for a wrong part.
    async with _multipart(storage) as (key, multipart_id):
        stated = _stated(storage.checksum, _OTHER)
        return not await _is_taken(storage.put_small_part(key, multipart_id, _BODY, stated))


async def _joins_right_part(storage: Storage) -> bool:
    async with _multipart(storage) as (key, multipart_id):
        stated = _stated(storage.checksum, _BODY)
        if not await _is_taken(storage.put_small_part(key, multipart_id, _BODY, stated)):
            return False
        if storage.checksum is ChecksumKind.crc64nvme and await _joins(storage, key, multipart_id, _OTHER):
            return False
        return await _joins(storage, key, multipart_id, _BODY)


@asynccontextmanager
async def _multipart(storage: Storage) -> AsyncIterator[tuple[str, str]]:
    key = f"probe/{uuid.uuid4()}"
    multipart_id = await storage.begin_multipart(key)
    try:
        yield key, multipart_id
    finally:
        await storage.abort_multipart(key, multipart_id)
        await storage.delete(key)


async def _joins(storage: Storage, key: str, multipart_id: str, whole: bytes) -> bool:
    crc = crc64nvme(whole).to_bytes(8, "big")
    try:
        return await _is_taken(storage.complete_multipart(key, multipart_id, count=1, crc64nvme=crc))
    except StoreMissing:  # joined by an earlier try, whose answer was lost
        return await storage.find(key) is not None


async def record_probe(db: Connection, store_id: str, abilities: Abilities) -> None:
    """Keep what the probe found, for whoever looks into the database, and say it in the log."""
    found = {"checksum": abilities.checksum.value, "writes_once": abilities.writes_once}
    values = {**found, "probed_at": func.now()}
    statement = upsert(store_probe).values(store_id=store_id, **values)
    await db.execute(statement.on_conflict_do_update(index_elements=["store_id"], set_=values))
    _log.info("store probed", extra={"fields": {"store_id": store_id, **found}})
