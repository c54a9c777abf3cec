"""The start-up probe: find out how this store proves what it receives, by trying to deceive it."""

import base64
import hashlib
import logging
import uuid

from awscrt.checksums import crc64nvme
from sqlalchemy import func
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.uploads import ChecksumKind
from kleinkram.server.db import Connection
from kleinkram.server.storage import Storage, StoreRefused
from kleinkram.server.tables import store_probe

_log = logging.getLogger("kleinkram.probe")
_BODY = b"kleinkram probes what this store verifies"
_OTHER = b"kleinkram probes what this store VERIFIES"


async def probe_checksum(storage: Storage) -> ChecksumKind:
    """Return the strongest proof that the store gives: it takes the right checksum and refuses a wrong one.

    Raises:
        StoreUnavailable: the store does not answer, or verifies nothing at all, so that nothing may be kept in it.
    """
    for kind in (ChecksumKind.crc64nvme, ChecksumKind.sha256, ChecksumKind.md5):
        if await _refuses_wrong(storage, kind) and (
            kind is not ChecksumKind.crc64nvme or await _joins_by_full_checksum(storage)
        ):
            return kind
    raise StoreUnavailable(reason="it accepts bytes that differ from their checksum, so it cannot keep recordings safe")


async def _refuses_wrong(storage: Storage, kind: ChecksumKind) -> bool:
    key = f"probe/{uuid.uuid4()}"
    try:
        await storage.put_small(key, _BODY, **_argument(kind, _BODY))
    except (StoreRefused, StoreUnavailable):
        return False
    try:
        await storage.put_small(f"{key}-wrong", _BODY, **_argument(kind, _OTHER))
    except (StoreRefused, StoreUnavailable):
        return True
    else:
        return False
    finally:
        await storage.delete(key)
        await storage.delete(f"{key}-wrong")


def _argument(kind: ChecksumKind, body: bytes) -> dict[str, str]:
    if kind is ChecksumKind.crc64nvme:
        return {"ChecksumCRC64NVME": base64.b64encode(crc64nvme(body).to_bytes(8, "big")).decode()}
    if kind is ChecksumKind.sha256:
        return {"ChecksumSHA256": base64.b64encode(hashlib.sha256(body).digest()).decode()}
    return {"ContentMD5": base64.b64encode(hashlib.md5(body, usedforsecurity=False).digest()).decode()}


async def _joins_by_full_checksum(storage: Storage) -> bool:
    key = f"probe/{uuid.uuid4()}"
    trial = storage.proving_by(ChecksumKind.crc64nvme)
    try:
        multipart_id = await trial.begin_multipart(key)
    except StoreRefused:
        return False
    try:
        await trial.put_small_part(key, multipart_id, _BODY)
        try:
            await trial.complete_multipart(key, multipart_id, crc64nvme=crc64nvme(_OTHER).to_bytes(8, "big"))
        except StoreRefused:
            await trial.complete_multipart(key, multipart_id, crc64nvme=crc64nvme(_BODY).to_bytes(8, "big"))
            return await trial.find(key) is not None
        return False
    except StoreRefused:
        return False
    finally:
        await trial.abort_multipart(key, multipart_id)
        await trial.delete(key)


async def record_probe(db: Connection, store_id: str, kind: ChecksumKind) -> None:
    """Keep what the probe found, for `klein doctor` and for whoever reads the database."""
    values = {"checksum": kind.value, "detail": f"refused a wrong {kind.value}", "probed_at": func.now()}
    statement = upsert(store_probe).values(store_id=store_id, **values)
    await db.execute(statement.on_conflict_do_update(index_elements=["store_id"], set_=values))
    _log.info("store probed", extra={"fields": {"store_id": store_id, "checksum": kind.value}})
