"""Detects at start-up what an S3 store supports: checksums, conditional writes, ranges. Sets its CORS rules."""

import base64
import hashlib
import logging
import uuid
from collections.abc import AsyncIterator, Awaitable, Collection
from contextlib import asynccontextmanager
from xml.sax.saxutils import escape

from sqlalchemy import func
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.uploads import ChecksumKind, crc64nvme
from kleinkram.server.db import Connection
from kleinkram.server.s3.storage import CHECKSUM_HEADERS, Storage, StoreCapabilities, StoreMissing, StoreRefused
from kleinkram.server.settings import Settings
from kleinkram.server.tables import store_probe

_probe_log = logging.getLogger("kleinkram.probe")
_log = logging.getLogger("kleinkram.store")
_BODY = b"kleinkram probes what this store verifies"
_OTHER_BODY = b"kleinkram probes what this store VERIFIES"
# Response headers that pages need beside the body: the ETag of a part, and which range of how many bytes arrived.
_EXPOSED_HEADERS = ("ETag", "Content-Length", "Content-Range", "Accept-Ranges")
_PREFLIGHT_MAX_AGE_S = 3600


async def probe(storage: Storage) -> StoreCapabilities:
    """Find the strongest checksum that the store verifies, and whether it refuses to overwrite an object.

    Raises:
        StoreUnavailable: the store does not answer, or verifies no checksum, so that no recording is safe in it.
    """
    await storage.check()
    for kind in (ChecksumKind.crc64nvme, ChecksumKind.sha256, ChecksumKind.md5):
        if await _refuses_wrong_object(storage, kind) and await _verifies_parts(storage.with_checksum(kind)):
            return StoreCapabilities(kind, writes_once=await _writes_once(storage))
    raise StoreUnavailable(reason="it accepts bytes that differ from their checksum, so it cannot keep recordings safe")


async def _is_accepted(writing: Awaitable[None]) -> bool:
    # Only the store's refusal counts: a store that does not answer has neither accepted nor refused.
    try:
        await writing
    except StoreRefused:
        return False
    return True


async def _refuses_wrong_object(storage: Storage, kind: ChecksumKind) -> bool:
    key = f"probe/{uuid.uuid4()}"
    try:
        if not await _is_accepted(storage.put_object(key, _BODY, _checksum_header(kind, _BODY))):
            return False
        wrong = storage.put_object(f"{key}-wrong", _BODY, _checksum_header(kind, _OTHER_BODY))
        return not await _is_accepted(wrong)
    finally:
        await storage.delete(key)
        await storage.delete(f"{key}-wrong")


async def _writes_once(storage: Storage) -> bool:
    key = f"probe/{uuid.uuid4()}"
    if_absent = {"If-None-Match": "*"}
    try:
        # A refused object may exist: written by an earlier attempt whose answer was lost.
        if not await _is_accepted(storage.put_object(key, _BODY, if_absent)) and await storage.find(key) is None:
            return False
        return not await _is_accepted(storage.put_object(key, _BODY, if_absent))
    finally:
        await storage.delete(key)


def _checksum_header(kind: ChecksumKind, body: bytes) -> dict[str, str]:
    if kind is ChecksumKind.crc64nvme:
        digest = crc64nvme(body).to_bytes(8, "big")
    elif kind is ChecksumKind.sha256:
        digest = hashlib.sha256(body).digest()
    else:
        digest = hashlib.md5(body, usedforsecurity=False).digest()
    return {CHECKSUM_HEADERS[kind]: base64.b64encode(digest).decode()}


async def _verifies_parts(storage: Storage) -> bool:
    """Check that wrong parts are refused and right ones joined: a store may treat parts unlike whole objects."""
    try:
        return await _refuses_wrong_part(storage) and await _joins_right_part(storage)
    except StoreRefused:  # it opens no multipart upload with this checksum
        return False


async def _refuses_wrong_part(storage: Storage) -> bool:
    # In an upload of its own: a store may drop the whole upload because of one wrong part.
    async with _multipart(storage) as (key, multipart_id):
        headers = _checksum_header(storage.checksum, _OTHER_BODY)
        return not await _is_accepted(storage.put_part(key, multipart_id, _BODY, headers))


async def _joins_right_part(storage: Storage) -> bool:
    async with _multipart(storage) as (key, multipart_id):
        headers = _checksum_header(storage.checksum, _BODY)
        if not await _is_accepted(storage.put_part(key, multipart_id, _BODY, headers)):
            return False
        if storage.checksum is ChecksumKind.crc64nvme and await _joins(storage, key, multipart_id, _OTHER_BODY):
            return False
        return await _joins(storage, key, multipart_id, _BODY)


@asynccontextmanager
async def _multipart(storage: Storage) -> AsyncIterator[tuple[str, str]]:
    key = f"probe/{uuid.uuid4()}"
    multipart_id = await storage.create_multipart(key)
    try:
        yield key, multipart_id
    finally:
        await storage.abort_multipart(key, multipart_id)
        await storage.delete(key)


async def _joins(storage: Storage, key: str, multipart_id: str, whole: bytes) -> bool:
    crc = crc64nvme(whole).to_bytes(8, "big")
    try:
        return await _is_accepted(storage.complete_multipart(key, multipart_id, count=1, crc64nvme=crc))
    except StoreMissing:  # joined by an earlier attempt whose answer was lost
        return await storage.find(key) is not None


async def record_capabilities(db: Connection, store_id: str, capabilities: StoreCapabilities) -> None:
    """Write the result of the probe into the database and the log."""
    result = {"checksum": capabilities.checksum.value, "writes_once": capabilities.writes_once}
    values = {**result, "probed_at": func.now()}
    statement = upsert(store_probe).values(store_id=store_id, **values)
    await db.execute(statement.on_conflict_do_update(index_elements=["store_id"], set_=values))
    _probe_log.info("store probed", extra={"fields": {"store_id": store_id, **result}})


async def configure_cors(storage: Storage, settings: Settings) -> bool:
    """Set the bucket's CORS rules, unless another party manages them; return whether our pages may upload.

    Our pages may upload and read, viewers' pages may read; signatures alone decide who may do what. A store that
    accepts no rules is used all the same: only browsers cannot upload and download.
    """
    reason = "another party manages the CORS rules of its bucket (KLEINKRAM_S3_CORS=leave)"
    if settings.s3_cors == "set":
        reason = "it accepted the CORS rules of its bucket, and does not follow them"
        viewers = {viewer.origin for viewer in settings.viewers} - {settings.public_origin}
        try:
            await storage.set_cors(cors_document(settings.public_origin, viewers))
        except (StoreRefused, StoreUnavailable) as error:
            reason = str(error)
    may_upload = await storage.allows_page(settings.public_origin, "PUT")
    if not may_upload:
        _log.warning(
            "the store does not allow our pages to upload: uploads by browser will fail; see docs/running.md, browsers",
            extra={"fields": {"origin": settings.public_origin, "reason": reason}},
        )
    return may_upload


def cors_document(own: str, viewers: Collection[str]) -> bytes:
    """Return a bucket's CORS rules for our origin and those of viewers.

    Source: Amazon S3 API Reference, PutBucketCors.
    """
    rules = [_cors_rule([own], ["GET", "HEAD", "PUT"])]
    if viewers:
        rules.append(_cors_rule(sorted(viewers), ["GET", "HEAD"]))
    namespace = "http://s3.amazonaws.com/doc/2006-03-01/"
    return f'<CORSConfiguration xmlns="{namespace}">{"".join(rules)}</CORSConfiguration>'.encode()


def _cors_rule(origins: Collection[str], methods: Collection[str]) -> str:
    elements = [
        *(f"<AllowedOrigin>{escape(origin)}</AllowedOrigin>" for origin in origins),
        *(f"<AllowedMethod>{method}</AllowedMethod>" for method in methods),
        "<AllowedHeader>*</AllowedHeader>",
        *(f"<ExposeHeader>{name}</ExposeHeader>" for name in _EXPOSED_HEADERS),
        f"<MaxAgeSeconds>{_PREFLIGHT_MAX_AGE_S}</MaxAgeSeconds>",
    ]
    return f"<CORSRule>{''.join(elements)}</CORSRule>"
