"""Rows and parts of uploads: makes the rows, signs the URLs of parts, lists those that the store has, joins them.

A URL is signed for one checksum, so the store accepts only the bytes that were announced.
"""

import asyncio
import datetime
import uuid
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence

from sqlalchemy import ColumnElement, Update, func, update

from kleinkram.contract import errors
from kleinkram.contract import uploads as protocol
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.names import name_key
from kleinkram.contract.uploads import ChecksumKind, UploadState
from kleinkram.server.access.actor import Actor
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import among, unnest_rows
from kleinkram.server.s3.storage import PartTarget, Storage, StoreMissing, StoreRefused
from kleinkram.server.settings import Settings
from kleinkram.server.tables import upload
from kleinkram.server.uploads import queries
from kleinkram.server.uploads.queries import UploadRow

_CONCURRENT_REQUESTS = 16
# From this number of objects with one prefix, one listing is cheaper than a request for each.
_MIN_FOR_LISTING = 4
_PROGRESS_EVERY_S = 2
# Viewers choose a reader by the suffix of a URL.
_VIEWER_SUFFIXES = (".mcap", ".bag")

Failures = dict[uuid.UUID, errors.KleinkramError]
"""Uploads that could not be finished, by id. After `UploadIncomplete` an upload may go on; any other error ends it."""


# -- the rows of uploads ----------------------------------------------------------------------------------------------


def lease_columns(settings: Settings, now: datetime.datetime | ColumnElement[datetime.datetime]) -> dict[str, object]:
    """Return the columns that renew the lease and expiry of an upload, for an insert or update."""
    return {
        "renewed_at": now,
        "lease_ends_at": now + datetime.timedelta(seconds=settings.upload_lease_s),
        "expires_at": now + datetime.timedelta(seconds=settings.upload_expires_s),
    }


def upload_columns(
    context: AppContext,
    person_id: uuid.UUID | None,
    mission_id: uuid.UUID,
    batch_id: uuid.UUID,
    requested: protocol.UploadFile,
    now: datetime.datetime,
    *,
    id_: uuid.UUID | None = None,
) -> dict[str, object]:
    """Return the columns of a new upload, for an insert."""
    upload_id = id_ or uuid.uuid4()
    suffix = next((suffix for suffix in _VIEWER_SUFFIXES if requested.path.lower().endswith(suffix)), "")
    return {
        "id": upload_id,
        "mission_id": mission_id,
        "person_id": person_id,
        "path": requested.path,
        "path_key": name_key(requested.path),
        "size_bytes": requested.size_bytes,
        "part_size_bytes": protocol.part_size_bytes(requested.size_bytes),
        "checksum": context.storage.checksum.value,
        "signed_checksum": announced_checksum(context.storage, requested),
        "store_id": context.settings.store_id,
        # One prefix per request, so that one listing finds its small files.
        "key": f"{batch_id}/{upload_id}{suffix}",
        **lease_columns(context.settings, now),
    }


def blob_columns(row: UploadRow, blob_id: uuid.UUID) -> dict[str, object]:
    """Return the columns of the blob that an upload becomes, for an insert."""
    # The client's value, so it is stored only if the store compared it.
    has_store_compared = row.checksum == ChecksumKind.crc64nvme.value
    return {
        "id": blob_id,
        "store_id": row.store_id,
        "key": row.key,
        "size_bytes": row.size_bytes,
        "crc64nvme": row.crc64nvme if has_store_compared else None,
        "sha256": row.sha256,
        "uploaded_by_id": row.person_id,
    }


def to_upload_read(row: UploadRow, parts: Sequence[protocol.StoredPart]) -> protocol.UploadRead:
    """Return an upload as its client sees it."""
    return protocol.UploadRead(
        id=row.id,
        mission_id=row.mission_id,
        path=row.path,
        size_bytes=row.size_bytes,
        part_size_bytes=row.part_size_bytes,
        checksum=ChecksumKind(row.checksum),
        state=UploadState(row.state),
        lease_ends_at=row.lease_ends_at,
        expires_at=row.expires_at,
        parts=list(parts),
    )


async def free_names(context: AppContext, upload_ids: Sequence[uuid.UUID]) -> None:
    """End new uploads whose client received no response about them."""
    async with context.database.begin() as db:
        is_open = among(upload.c.id, upload_ids) & (upload.c.state == UploadState.open.value)
        await db.execute(update(upload).where(is_open).values(state=UploadState.aborted.value))


# -- signing ----------------------------------------------------------------------------------------------------------


async def sign_parts(
    context: AppContext, actor: Actor, *, parts: Sequence[protocol.PartToSign]
) -> list[protocol.SignedPart]:
    """Return the URLs of parts, in the order of the request, and renew the leases of their uploads.

    Raises:
        UploadGone: an upload has ended, or its only part was signed with another checksum before.
        InvalidRequest: the file has no such part, or the checksum is of another kind.
    """
    async with context.database.begin() as db:
        uploads = await queries.lock_own_uploads(db, actor, {part.upload_id for part in parts})
        for part in parts:
            _check_signable(uploads.get(part.upload_id), part)
        checksums = {part.upload_id: None if uploads[part.upload_id].is_multipart else part.checksum for part in parts}
        await db.execute(_renew_leases(context.settings, checksums))
        progress = [row for row in uploads.values() if _is_progress_due(row)]
        await publish(
            db, [ChangeEvent("upload", ChangeKind.changed, row.id, mission_id=row.mission_id) for row in progress]
        )
    expires_at = _url_expiry(context.settings)
    return [_sign(context, uploads[part.upload_id], part, expires_at) for part in parts]


def _check_signable(row: UploadRow | None, part: protocol.PartToSign) -> None:
    if row is None or row.state != UploadState.open.value or row.is_expired:
        raise errors.UploadGone(upload_id=str(part.upload_id))
    if row.is_multipart and row.multipart_id is None:  # the server died before it recorded the store's answer
        raise errors.UploadGone(upload_id=str(part.upload_id))
    digits = protocol.CHECKSUM_HEX_DIGITS[ChecksumKind(row.checksum)]
    if len(part.checksum) != digits:
        message = f"{row.path!r} is verified by {row.checksum}, which has {digits} hex digits, not {len(part.checksum)}"
        raise errors.InvalidRequest(problems=[errors.FieldProblem(field="parts.checksum", message=message)])
    if not row.is_multipart and row.signed_checksum not in {None, part.checksum}:
        raise errors.UploadGone(upload_id=str(part.upload_id))
    if part.number > row.part_count:
        message = f"{row.path!r} has {row.part_count} parts of {row.part_size_bytes} bytes, and no part {part.number}"
        raise errors.InvalidRequest(problems=[errors.FieldProblem(field="parts.number", message=message)])


def _renew_leases(settings: Settings, checksums: Mapping[uuid.UUID, str | None]) -> Update:
    """Return the statement that renews leases and records the signed checksum of only parts."""
    rows = [{"id": upload_id, "signed_checksum": checksum} for upload_id, checksum in checksums.items()]
    values = unnest_rows([upload.c.id, upload.c.signed_checksum], rows)
    signed_checksum = func.coalesce(upload.c.signed_checksum, values.c.signed_checksum)
    renew = update(upload).where(upload.c.id == values.c.id)
    return renew.values(**lease_columns(settings, func.now()), signed_checksum=signed_checksum)


def _is_progress_due(row: UploadRow) -> bool:
    """Return whether to publish progress: not for each request, and not for small files."""
    return row.is_multipart and (row.now - row.renewed_at).total_seconds() > _PROGRESS_EVERY_S


def announced_checksum(storage: Storage, requested: protocol.UploadFile) -> str | None:
    """Return the checksum of a file's only part; None if it has several, or if no hash was announced."""
    if requested.size_bytes > protocol.part_size_bytes(requested.size_bytes):
        return None
    announced = {ChecksumKind.crc64nvme: requested.crc64nvme, ChecksumKind.sha256: requested.sha256}
    return announced.get(storage.checksum)


def sign_only_part(context: AppContext, row: UploadRow, requested: protocol.UploadFile) -> protocol.SignedPart | None:
    """Return the URL of a file's only part, if the row was signed for the announced checksum."""
    checksum = announced_checksum(context.storage.with_checksum(ChecksumKind(row.checksum)), requested)
    if checksum is None or row.signed_checksum != checksum:
        return None
    part = protocol.PartToSign(upload_id=row.id, number=1, checksum=checksum)
    return _sign(context, row, part, _url_expiry(context.settings))


def _url_expiry(settings: Settings) -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=settings.part_url_s)


def _sign(
    context: AppContext, row: UploadRow, part: protocol.PartToSign, expires_at: datetime.datetime
) -> protocol.SignedPart:
    target = PartTarget(row.key, row.multipart_id, part.number, row.part_bytes(part.number), part.checksum)
    storage = context.storage.with_checksum(ChecksumKind(row.checksum))
    signed = storage.sign_part(target, expires_s=context.settings.part_url_s)
    return protocol.SignedPart(
        upload_id=row.id, number=part.number, url=signed.url, headers=signed.headers, expires_at=expires_at
    )


# -- what the store has -----------------------------------------------------------------------------------------------


async def open_multiparts(
    context: AppContext, uploads: Sequence[UploadRow], *, resumed: Collection[uuid.UUID] = ()
) -> dict[uuid.UUID, list[protocol.StoredPart]]:
    """Open the multipart uploads that the store does not have yet, and return the parts that it has of each.

    A `resumed` upload may be open at the store although its id was never recorded: the process died between.
    """
    limit = asyncio.Semaphore(_CONCURRENT_REQUESTS)

    async def open_one(row: UploadRow) -> tuple[UploadRow, str, list[protocol.StoredPart]]:
        async with limit:
            return row, *await _find_or_create(context.storage, row, is_resumed=row.id in resumed)

    answers = await asyncio.gather(*(open_one(row) for row in uploads), return_exceptions=True)
    opened = [answer for answer in answers if not isinstance(answer, BaseException)]
    async with context.database.begin() as db:
        for row, multipart_id, _ in opened:
            if row.multipart_id != multipart_id:
                await db.execute(update(upload).where(upload.c.id == row.id).values(multipart_id=multipart_id))
    for answer in answers:
        if isinstance(answer, BaseException):
            raise answer
    return {row.id: parts for row, _, parts in opened}


async def _find_or_create(
    storage: Storage, row: UploadRow, *, is_resumed: bool
) -> tuple[str, list[protocol.StoredPart]]:
    if row.multipart_id is not None:
        parts = await storage.list_parts(row.key, row.multipart_id)
        if parts is not None:
            return row.multipart_id, parts
    elif is_resumed:
        for multipart in await storage.list_multiparts(row.key):
            return multipart.multipart_id, await storage.list_parts(row.key, multipart.multipart_id) or []
    return await storage.create_multipart(row.key), []


async def stored_small_files(
    storage: Storage, uploads: Sequence[UploadRow]
) -> dict[uuid.UUID, list[protocol.StoredPart]]:
    """Return the only part of each one-part upload whose complete file the store has."""
    signed = [row for row in uploads if not row.is_multipart and row.signed_checksum is not None]
    objects: dict[str, protocol.StoredPart] = {}
    for prefix, group in _by_prefix(signed).items():
        for listed_prefix in [prefix] if len(group) >= _MIN_FOR_LISTING else [row.key for row in group]:
            objects |= await storage.list_objects(listed_prefix)
    return {row.id: [part] for row in signed if (part := objects.get(row.key)) and part.size_bytes == row.size_bytes}


def _by_prefix(uploads: Sequence[UploadRow]) -> dict[str, list[UploadRow]]:
    groups = defaultdict[str, list[UploadRow]](list)
    for row in uploads:
        groups[row.key.split("/")[0] + "/"].append(row)
    return groups


# -- joining ----------------------------------------------------------------------------------------------------------


async def join_parts(storage: Storage, uploads: Sequence[UploadRow]) -> Failures:
    """Have the store join the parts of each upload, check the result, and return the uploads that failed."""
    limit = asyncio.Semaphore(_CONCURRENT_REQUESTS)

    async def join(row: UploadRow) -> tuple[uuid.UUID, errors.KleinkramError | None]:
        async with limit:
            return row.id, await _join(storage.with_checksum(ChecksumKind(row.checksum)), row)

    failures = await _check_small_files(storage, [row for row in uploads if not row.is_multipart])
    for upload_id, error in await asyncio.gather(*(join(row) for row in uploads if row.is_multipart)):
        if error is not None:
            failures[upload_id] = error
    return failures


async def _check_small_files(storage: Storage, uploads: Sequence[UploadRow]) -> Failures:
    """Check that one-part files arrived. Each URL was signed for one checksum, so only the size is compared."""
    sizes: dict[str, int] = {}
    for prefix, group in _by_prefix(uploads).items():
        if len(group) >= _MIN_FOR_LISTING:
            sizes |= await storage.sizes(prefix)
        else:
            for row in group:
                stored = await storage.find(row.key)
                sizes |= {row.key: stored.size_bytes} if stored else {}
    return {
        row.id: errors.UploadIncomplete(path=row.path, reason="the file has not arrived")
        for row in uploads
        if sizes.get(row.key) != row.size_bytes
    }


async def _join(storage: Storage, row: UploadRow) -> errors.KleinkramError | None:
    error = await _request_join(storage, row)
    stored = await storage.find(row.key)
    if stored is None:
        return error
    # Several requests may join the same parts at once, so the object counts, not the response to this one.
    if stored.size_bytes != row.size_bytes or stored.crc64nvme not in {None, row.crc64nvme}:
        return errors.ChecksumMismatch(path=row.path, reason="the store's own checksum of the whole differs")
    return None


async def _request_join(storage: Storage, row: UploadRow) -> errors.KleinkramError:
    """Have the store join the parts; return the error to report if there is no object afterwards."""
    gone = errors.UploadGone(upload_id=str(row.id))
    if row.multipart_id is None:
        parts: list[protocol.StoredPart] | None = []
    else:
        parts = await storage.list_parts(row.key, row.multipart_id)
    if parts is None:
        return gone
    complete = {part.number for part in parts if part.size_bytes == row.part_bytes(part.number)}
    missing = sorted(set(range(1, row.part_count + 1)) - complete)
    if missing or row.multipart_id is None:
        reason = f"{len(missing)} of {row.part_count} parts, the first is {missing[0]}"
        return errors.UploadIncomplete(path=row.path, reason=reason)
    try:
        await storage.complete_multipart(row.key, row.multipart_id, count=row.part_count, crc64nvme=row.crc64nvme)
    except StoreMissing:
        return gone
    except StoreRefused as error:
        if error.is_wrong_checksum:
            return errors.ChecksumMismatch(path=row.path, reason=str(error))
        return errors.UploadIncomplete(path=row.path, reason=str(error))
    return gone
