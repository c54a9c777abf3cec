"""The parts of an upload: how many there are, how large each is, and the addresses to send them to.

An address is signed for one checksum: what arrives there is what was announced, or nothing.
"""

import datetime
import uuid
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Row, Update, func, update

from kleinkram.contract.errors import FieldProblem, InvalidRequest, UploadGone
from kleinkram.contract.events import ChangeKind
from kleinkram.contract.uploads import (
    CHECKSUM_HEX_DIGITS,
    ChecksumKind,
    PartToSign,
    SignedPart,
    UploadFile,
    UploadState,
    part_size_bytes,
)
from kleinkram.server.access.actor import Actor
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import unnest_rows
from kleinkram.server.settings import Settings
from kleinkram.server.storage import PartTarget, Storage
from kleinkram.server.tables import upload
from kleinkram.server.uploads import queries

_TOLD_EVERY_S = 2


def is_multipart(row: Row[Any]) -> bool:
    """Say whether a file goes up in several parts; else it is one plain PUT."""
    return bool(row.size_bytes > row.part_size_bytes)


def expected_part_bytes(row: Row[Any], number: int) -> int:
    """Return the size of a part, counted from 1: all but the last are alike."""
    return int(min(row.part_size_bytes, row.size_bytes - (number - 1) * row.part_size_bytes))


def renewed(settings: Settings, now: Any) -> dict[str, Any]:
    """Return until when a name is held and an upload kept; `now` is a time, or the database's own."""
    return {
        "lease_ends_at": now + datetime.timedelta(seconds=settings.upload_lease_s),
        "expires_at": now + datetime.timedelta(seconds=settings.upload_expires_s),
    }


async def sign_parts(context: AppContext, actor: Actor, *, wanted: Sequence[PartToSign]) -> list[SignedPart]:
    """Return where to send parts, in the order asked, and renew the leases of their uploads.

    Raises:
        UploadGone: an upload has ended, or a file of one part was announced with another checksum before.
        InvalidRequest: a part that the file does not have.
    """
    async with context.database.begin() as db:
        ids = {part.upload_id for part in wanted}
        rows = await queries.locked_uploads(db, actor, ids)
        for part in wanted:
            _check_signable(rows.get(part.upload_id), part)
        checksums = {p.upload_id: None if is_multipart(rows[p.upload_id]) else p.checksum for p in wanted}
        await db.execute(_renewal(context.settings, checksums))
        await publish(db, [_progress(row) for row in rows.values() if _is_worth_telling(row, context.settings)])
    expires_at = _end(context.settings)
    return [_sign(context, rows[part.upload_id], part, expires_at) for part in wanted]


def _renewal(settings: Settings, checksums: Mapping[uuid.UUID, str | None]) -> Update:
    """Return what renews leases, and writes down what files of one part are signed for."""
    rows = [{"id": upload_id, "signed_checksum": checksum} for upload_id, checksum in checksums.items()]
    said = unnest_rows([upload.c.id, upload.c.signed_checksum], rows)
    signed_checksum = func.coalesce(upload.c.signed_checksum, said.c.signed_checksum)
    renewing = update(upload).where(upload.c.id == said.c.id)
    return renewing.values(**renewed(settings, func.now()), signed_checksum=signed_checksum)


def _progress(row: Row[Any]) -> ChangeEvent:
    return ChangeEvent("upload", ChangeKind.changed, row.id, mission_id=row.mission_id)


def _is_worth_telling(row: Row[Any], settings: Settings) -> bool:
    """Say of an upload whether some time has passed since its last parts were signed; small files end soon anyway."""
    quiet: datetime.timedelta = row.now - row.lease_ends_at
    return is_multipart(row) and quiet.total_seconds() + settings.upload_lease_s > _TOLD_EVERY_S


def _check_signable(row: Row[Any] | None, part: PartToSign) -> None:
    if row is None or row.state != UploadState.open.value or row.is_expired:
        raise UploadGone(upload_id=str(part.upload_id))
    if is_multipart(row) and row.multipart_id is None:  # the server died before the store's answer was written down
        raise UploadGone(upload_id=str(part.upload_id))
    digits = CHECKSUM_HEX_DIGITS[ChecksumKind(row.checksum)]
    if len(part.checksum) != digits:
        message = f"{row.path!r} is verified by {row.checksum}, which has {digits} hex digits, not {len(part.checksum)}"
        raise InvalidRequest(problems=[FieldProblem(field="parts.checksum", message=message)])
    if not is_multipart(row) and row.signed_checksum not in {None, part.checksum}:
        raise UploadGone(upload_id=str(part.upload_id))
    count = max(1, -(-row.size_bytes // row.part_size_bytes))
    if part.number > count:
        message = (
            f"{row.path!r} has {count} parts of {row.part_size_bytes} bytes; part {part.number} is not one of them"
        )
        raise InvalidRequest(problems=[FieldProblem(field="parts.number", message=message)])


def first_checksum(storage: Storage, wanted: UploadFile) -> str | None:
    """Return what the only part of a file is signed for; None where there are more, or its hash was not announced."""
    if wanted.size_bytes > part_size_bytes(wanted.size_bytes):
        return None
    announced = {ChecksumKind.crc64nvme: wanted.crc64nvme, ChecksumKind.sha256: wanted.sha256}
    return announced.get(storage.checksum)


def sign_first(context: AppContext, row: Row[Any], wanted: UploadFile) -> SignedPart | None:
    """Return where the only part of a file goes, once the row says that it is signed for what is announced."""
    checksum = first_checksum(context.storage.verifying_by(ChecksumKind(row.checksum)), wanted)
    if checksum is None or row.signed_checksum != checksum:
        return None
    return _sign(context, row, PartToSign(upload_id=row.id, number=1, checksum=checksum), _end(context.settings))


def _end(settings: Settings) -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=settings.part_url_s)


def _sign(context: AppContext, row: Row[Any], part: PartToSign, expires_at: datetime.datetime) -> SignedPart:
    size_bytes = expected_part_bytes(row, part.number)
    target = PartTarget(row.key, row.multipart_id, part.number, size_bytes, part.checksum)
    storage = context.storage.verifying_by(ChecksumKind(row.checksum))
    signed = storage.sign_part(target, expires_s=context.settings.part_url_s)
    return SignedPart(
        upload_id=row.id, number=part.number, url=signed.url, headers=signed.headers, expires_at=expires_at
    )
