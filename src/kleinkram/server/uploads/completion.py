"""The end of an upload, in three steps: mark the rows, let the store join the parts, make the files.

Every step can be repeated: by a client that lost the response, by one that begins again after a crash, or by the
periodic job (`jobs.py`).
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import ColumnElement, case, func, select, update

from kleinkram.contract.access import Scope
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.errors import (
    ChecksumMismatch,
    Forbidden,
    KleinkramError,
    NotFound,
    PathConflict,
    UploadGone,
    UploadIncomplete,
)
from kleinkram.contract.problems import ProblemDocument, from_problem, to_problem
from kleinkram.contract.uploads import (
    ChecksumKind,
    Completed,
    NotCompleted,
    UploadFile,
    UploadFinish,
    UploadOutcome,
    UploadState,
)
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs.service import enqueue_reading
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among, insert_rows, unnest_rows
from kleinkram.server.files import service as files
from kleinkram.server.files.paths import conflicts_among, path_conflicts, visible_conflicts
from kleinkram.server.missions import service as missions
from kleinkram.server.quotas import project_of
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.tables import blob, file, upload
from kleinkram.server.uploads import queries
from kleinkram.server.uploads.artifacts import make_artifacts
from kleinkram.server.uploads.parts import Failures, blob_columns, join_parts
from kleinkram.server.uploads.queries import ExistingFile, UploadRow


async def complete_uploads(
    context: AppContext, actor: Actor, *, finishes: Sequence[UploadFinish]
) -> list[UploadOutcome]:
    """Finish uploads whose parts are all sent. One that fails does not affect the others. Idempotent."""
    async with context.database.begin() as db:
        uploads, failures = await _mark_completing(db, actor, finishes)
    pending = [row for row in uploads if row.id not in failures and row.state != UploadState.done.value]
    failures |= await finish_uploads(context, actor, pending)
    async with context.database.begin() as db:
        rows = await queries.read_rows(
            db, queries.select_uploads().where(among(upload.c.id, [row.id for row in uploads]))
        )
        file_ids = [row.file_id for row in rows if row.file_id]
        visible = {read.id: read for read in await files.read_visible_files(db, actor, file_ids)}
    by_id = {row.id: row for row in rows}
    just_finished = {row.id for row in pending}
    outcomes: list[UploadOutcome] = []
    for finish in finishes:
        row, error = by_id.get(finish.upload_id), failures.get(finish.upload_id)
        read = visible.get(row.file_id) if row is not None and row.file_id else None
        # The file exists but is not visible: the token may not read, or the file was just deleted.
        is_hidden = row is not None and row.file_id is not None
        is_hidden = is_hidden and (Scope.read not in actor.scopes or finish.upload_id in just_finished)
        is_artifact = row is not None and row.run_id is not None and row.state == UploadState.done.value
        if error is None and (read is not None or is_hidden or is_artifact):
            outcomes.append(Completed(upload_id=finish.upload_id, file=read))
        else:
            problem = to_problem(error or UploadGone(upload_id=str(finish.upload_id)), actor.request_id)
            outcomes.append(NotCompleted(upload_id=finish.upload_id, problem=problem))
    return outcomes


async def finish_uploads(context: AppContext, actor: Actor, uploads: Sequence[UploadRow]) -> Failures:
    """Finish marked uploads at the store and in the database; return those that failed."""
    failures = await join_parts(context.storage, uploads)
    destinations: dict[tuple[uuid.UUID, uuid.UUID | None], list[UploadRow]] = {}
    for row in uploads:
        if row.id not in failures:
            destinations.setdefault((row.mission_id, row.run_id), []).append(row)
    for (mission_id, run_id), joined in destinations.items():
        async with context.database.begin() as db:
            if run_id is None:
                failures |= await _make_files(db, actor, mission_id, joined)
            else:
                failures |= await make_artifacts(db, run_id, joined)
        arrived = [row.size_bytes for row in joined if row.id not in failures]
        metrics.count_uploads("stored", files=len(arrived), size_bytes=sum(arrived))
    if failures:
        async with context.database.begin() as db:
            await _record_failures(db, actor, failures)
    return failures


# -- marking ----------------------------------------------------------------------------------------------------------


async def _mark_completing(
    db: Connection, actor: Actor, finishes: Sequence[UploadFinish]
) -> tuple[list[UploadRow], Failures]:
    """Mark uploads as completing, with the hashes that the client sends.

    Returns the uploads as they are now, in the order asked (of two that conflict, the first wins), and the failures.
    """
    locked = await queries.lock_own_uploads(db, actor, [finish.upload_id for finish in finishes])
    failures: Failures = {}
    hashes: dict[uuid.UUID, dict[str, object]] = {}
    for finish in finishes:
        row = locked.get(finish.upload_id)
        error = _reason_against(row, finish)
        if error is not None:
            failures[finish.upload_id] = error
        elif row is not None and row.state != UploadState.done.value:
            checksums = {"sha256": bytes.fromhex(finish.sha256), "crc64nvme": bytes.fromhex(finish.crc64nvme)}
            hashes[row.id] = {"id": row.id, **checksums}
    if hashes:
        values = unnest_rows([upload.c.id, upload.c.sha256, upload.c.crc64nvme], [*hashes.values()])
        marked = {"state": UploadState.completing.value, "completing_since": func.now()}
        statement = update(upload).where(upload.c.id == values.c.id)
        await db.execute(statement.values(**marked, sha256=values.c.sha256, crc64nvme=values.c.crc64nvme))
    ids = dict.fromkeys(finish.upload_id for finish in finishes)
    rows = await queries.read_rows(db, queries.select_uploads().where(among(upload.c.id, ids)))
    by_id = {row.id: row for row in rows}
    return [by_id[upload_id] for upload_id in ids if upload_id in by_id], failures


def _reason_against(row: UploadRow | None, finish: UploadFinish) -> KleinkramError | None:
    """Return why an upload cannot be completed, or None."""
    if row is None:
        return UploadGone(upload_id=str(finish.upload_id))
    if row.failure is not None:
        return from_problem(ProblemDocument.model_validate_json(row.failure))
    if row.state in {UploadState.aborted.value, UploadState.expired.value}:
        return UploadGone(upload_id=str(finish.upload_id))
    if row.state == UploadState.done.value or row.is_multipart:
        return None
    if row.signed_checksum is None:
        return UploadIncomplete(path=row.path, reason="nothing was sent yet")
    announced = {ChecksumKind.crc64nvme.value: finish.crc64nvme, ChecksumKind.sha256.value: finish.sha256}
    if announced.get(row.checksum) not in {None, row.signed_checksum}:
        return ChecksumMismatch(path=row.path, reason="its checksum was announced differently when it was sent")
    return None


# -- making files -----------------------------------------------------------------------------------------------------


async def _make_files(db: Connection, actor: Actor, mission_id: uuid.UUID, uploads: Sequence[UploadRow]) -> Failures:
    """Make the blob and file of each upload, in one transaction with the audit events and the jobs that follow."""
    try:
        await missions.lock_mission_to_fill(db, actor, mission_id)
    except (NotFound, Forbidden):
        return {row.id: UploadGone(upload_id=str(row.id)) for row in uploads}
    unfinished = await queries.lock_unfinished(db, uploads)
    placements = await _placements(db, actor, mission_id, unfinished)
    used = [placement for placement in placements if placement.error is None and placement.needs_blob]
    file_ids = await _create_or_repair(db, actor, mission_id, used)
    file_ids |= {p.upload.id: p.file_id for p in placements if p.file_id and not p.needs_blob}
    await _mark_done(db, mission_id, file_ids)
    return {placement.upload.id: placement.error for placement in placements if placement.error is not None}


@dataclass(frozen=True)
class Placement:
    """Where a completed upload goes: into a new file, or into the existing file `file_id`; or why nowhere.

    `needs_blob`: the uploaded bytes are used. Otherwise, the file has the same bytes already.
    """

    upload: UploadRow
    file_id: uuid.UUID | None = None
    needs_blob: bool = True
    error: KleinkramError | None = None


def placement_of(
    upload: UploadRow, existing: ExistingFile | None, conflict: str | None, *, may_read: bool
) -> Placement:
    """Decide what becomes of an upload whose bytes the store has: a new file, a repaired one, or a refusal."""
    if conflict is not None:
        return Placement(upload, error=PathConflict(path=upload.path, other=conflict))
    if existing is None:
        return Placement(upload)
    if existing.content != upload.content:
        return Placement(upload, error=existing.exists_error(upload.path, upload.content, may_read=may_read))
    # The same bytes repair a damaged file; an undamaged one was linked or moved here since.
    return Placement(upload, file_id=existing.id, needs_blob=existing.is_damaged)


async def _placements(
    db: Connection, actor: Actor, mission_id: uuid.UUID, uploads: Sequence[UploadRow]
) -> list[Placement]:
    may_read = Scope.read in actor.scopes
    paths = [row.path for row in uploads]
    existing = await queries.existing_files(db, mission_id, [row.path_key for row in uploads])
    conflicts = visible_conflicts(await path_conflicts(db, mission_id, paths), may_read=may_read)
    conflicts |= {paths[position]: other for position, other in conflicts_among(paths).items()}
    return [
        placement_of(row, existing.get(row.path_key), conflicts.get(row.path), may_read=may_read) for row in uploads
    ]


async def _create_or_repair(
    db: Connection, actor: Actor, mission_id: uuid.UUID, placements: Sequence[Placement]
) -> dict[uuid.UUID, uuid.UUID]:
    """Make a blob from each upload, for a new file or in place of a damaged file's blob; return the files' ids."""
    if not placements:
        return {}
    blob_ids = {placement.upload.id: uuid.uuid4() for placement in placements}
    await db.execute(insert_rows(blob, [blob_columns(p.upload, blob_ids[p.upload.id]) for p in placements]))
    repaired = {p.upload.id: p.file_id for p in placements if p.file_id}
    for upload_id, file_id in repaired.items():
        await db.execute(update(file).where(file.c.id == file_id).values(blob_id=blob_ids[upload_id]))
    created = {p.upload.id: uuid.uuid4() for p in placements if p.file_id is None}
    new_files = [
        {
            "id": created[row.id],
            "mission_id": mission_id,
            "blob_id": blob_ids[row.id],
            "path": row.path,
            "path_key": row.path_key,
            "origin": "upload",
            "uploaded_by_id": row.person_id,
        }
        for row in (placement.upload for placement in placements)
        if row.id in created
    ]
    if new_files:
        await db.execute(insert_rows(file, new_files))
    file_ids = repaired | created
    project_id = await project_of(db, mission_id)
    events = [
        Event(
            "file.repair" if row.id in repaired else "file.upload",
            "file",
            file_ids[row.id],
            row.path,
            project_id,
            after={"size_bytes": row.size_bytes, "sha256": row.sha256.hex()},
            mission_id=mission_id,
        )
        for row in (placement.upload for placement in placements)
    ]
    await audit(db, actor, *events)
    await enqueue_reading(db, list(blob_ids.values()))
    await derive_again(db, mission_id)
    return file_ids


async def _mark_done(db: Connection, mission_id: uuid.UUID, file_ids: Mapping[uuid.UUID, uuid.UUID]) -> None:
    if not file_ids:
        return
    # An object that no blob uses, because the same bytes arrived otherwise, is cleaned up later.
    is_used = select(blob.c.id).where(blob.c.store_id == upload.c.store_id, blob.c.key == upload.c.key).exists()
    rows = [{"id": upload_id, "file_id": file_id} for upload_id, file_id in file_ids.items()]
    values = unnest_rows([upload.c.id, upload.c.file_id], rows)
    cleaned_at = case((is_used, func.now()), else_=upload.c.cleaned_at)
    columns = {"state": UploadState.done.value, "file_id": values.c.file_id, "cleaned_at": cleaned_at}
    await db.execute(update(upload).where(upload.c.id == values.c.id).values(**columns))
    await publish(db, [removed_event(upload_id, mission_id) for upload_id in file_ids])


async def _record_failures(db: Connection, actor: Actor, failures: Failures) -> None:
    """Reopen incomplete uploads, so that the rest can be sent; end all others and store the reason."""
    is_completing = upload.c.state == UploadState.completing.value
    incomplete = [upload_id for upload_id, error in failures.items() if isinstance(error, UploadIncomplete)]
    if incomplete:
        reopen = update(upload).where(among(upload.c.id, incomplete), is_completing)
        await db.execute(reopen.values(state=UploadState.open.value, completing_since=None))
    for upload_id, error in failures.items():
        if upload_id in incomplete:
            continue
        values = {"state": UploadState.aborted.value, "failure": to_problem(error, actor.request_id).model_dump_json()}
        end = update(upload).where(upload.c.id == upload_id, is_completing).values(**values)
        for row in await db.execute(end.returning(upload.c.id, upload.c.mission_id)):
            await publish(db, [removed_event(row.id, row.mission_id)])


def removed_event(upload_id: uuid.UUID, mission_id: uuid.UUID) -> ChangeEvent:
    """Return the event that an upload has ended."""
    return ChangeEvent("upload", ChangeKind.removed, upload_id, mission_id=mission_id)


# -- after a crash ----------------------------------------------------------------------------------------------------


async def finish_interrupted(
    context: AppContext, actor: Actor, *, mission_id: uuid.UUID, requested: Sequence[UploadFile]
) -> None:
    """Finish the actor's uploads that were being completed when their client died, and that it announces again.

    Raises:
        StoreUnavailable: the store does not answer.
    """
    is_continued = among(upload.c.id, [file.upload_id for file in requested if file.upload_id])
    await _finish_own(context, actor, (upload.c.mission_id == mission_id) & is_continued)


async def finish_interrupted_artifacts(
    context: AppContext, actor: Actor, *, run_id: uuid.UUID, paths: Sequence[str]
) -> None:
    """Finish a run's artifacts that were being completed when its runner died.

    Raises:
        StoreUnavailable: the store does not answer.
    """
    await _finish_own(context, actor, (upload.c.run_id == run_id) & among(upload.c.path, paths))


async def _finish_own(context: AppContext, actor: Actor, condition: ColumnElement[bool]) -> None:
    is_completing = upload.c.state == UploadState.completing.value
    async with context.database.autocommit() as db:
        ids = (await db.execute(select(upload.c.id).where(condition, is_completing))).scalars().all()
        if not ids:  # nearly always; saves the slower query for their owner
            return
        uploads = await queries.read_rows(db, queries.own_uploads(actor).where(among(upload.c.id, ids)))
    await finish_uploads(context, actor, uploads)
