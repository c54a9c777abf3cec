"""The end of an upload: mark it, let the store join and judge the bytes, then make the file.

Every step can be repeated: by the client that lost the answer, or by the job that finds what a crash left.
"""

import datetime
import logging
import uuid
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, case, func, select, update

from kleinkram.contract.errors import (
    ChecksumMismatch,
    FileExists,
    Forbidden,
    KleinkramError,
    NotFound,
    PathConflict,
    UploadGone,
    UploadIncomplete,
)
from kleinkram.contract.events import ChangeKind
from kleinkram.contract.problems import ProblemDocument, from_problem, to_problem
from kleinkram.contract.rights import Scope
from kleinkram.contract.uploads import (
    ChecksumKind,
    Completed,
    NotCompleted,
    UploadFile,
    UploadFinish,
    UploadOutcome,
    UploadState,
)
from kleinkram.server.access.actor import Actor, find_person
from kleinkram.server.audit.service import Event, record_all
from kleinkram.server.blobs.service import examine_blobs
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among, insert_rows, unnest_rows
from kleinkram.server.files import service as files
from kleinkram.server.files.paths import path_conflicts
from kleinkram.server.missions import service as missions
from kleinkram.server.recordings.service import regroup
from kleinkram.server.tables import blob, file, upload
from kleinkram.server.uploads import queries
from kleinkram.server.uploads.artifacts import make_artifacts
from kleinkram.server.uploads.joining import Failures, join_at_store
from kleinkram.server.uploads.rules import UNREADABLE, as_shown, blob_values, first_come
from kleinkram.server.uploads.signing_parts import is_multipart

_log = logging.getLogger("kleinkram.uploads")


async def complete_uploads(
    context: AppContext, actor: Actor, *, finishes: Sequence[UploadFinish]
) -> list[UploadOutcome]:
    """Finish uploads whose parts are all sent; one that fails does not hold up the others. Idempotent."""
    failures: Failures = {}
    async with context.database.begin() as db:
        rows = await _mark(db, actor, finishes, failures)
    pending = [row for row in rows.values() if row.id not in failures and row.state != UploadState.done.value]
    failures |= await settle(context, actor, pending)
    fresh = {row.id for row in pending}
    async with context.database.begin() as db:
        columns = (upload.c.id, upload.c.file_id, upload.c.run_id, upload.c.state)
        found = (await db.execute(select(*columns).where(among(upload.c.id, rows)))).all()
        made = {row.id: row.file_id for row in found if row.file_id}
        artifacts = {row.id for row in found if row.run_id and row.state == UploadState.done.value}
        reads = {read.id: read for read in await files.read_visible_files(db, actor, list(made.values()))}
    outcomes: list[UploadOutcome] = []
    for finish in finishes:
        read = reads.get(made.get(finish.upload_id, finish.upload_id))
        # Made, and not seen: by who may not read, or since it was deleted before it could be looked at.
        is_unseen = finish.upload_id in made and (Scope.read not in actor.scopes or finish.upload_id in fresh)
        is_there = read is not None or is_unseen or finish.upload_id in artifacts
        if is_there and finish.upload_id not in failures:
            outcomes.append(Completed(upload_id=finish.upload_id, file=read))
        else:
            error = failures.get(finish.upload_id, UploadGone(upload_id=str(finish.upload_id)))
            problem = to_problem(error, actor.request_id)
            outcomes.append(NotCompleted(upload_id=finish.upload_id, problem=problem))
    return outcomes


async def settle(context: AppContext, actor: Actor, rows: Sequence[Row[Any]]) -> Failures:
    """Take marked uploads to their end at the store and in the database; return those that failed, and why."""
    failures = await join_at_store(context.storage, rows)
    joined = [row for row in rows if row.id not in failures]
    by_place: dict[tuple[uuid.UUID, uuid.UUID | None], list[Row[Any]]] = {}
    for row in joined:
        by_place.setdefault((row.mission_id, row.run_id), []).append(row)
    for (mission_id, run_id), group in by_place.items():
        async with context.database.begin() as db:
            if run_id is None:
                failures |= await _make_files(db, actor, mission_id, group)
            else:
                failures |= await make_artifacts(db, run_id, group)
    if not failures:
        return failures
    ended = {key: error for key, error in failures.items() if not isinstance(error, UploadIncomplete)}
    async with context.database.begin() as db:
        await _note_failures(db, actor, failures, ended)
    return failures


async def _mark(
    db: Connection, actor: Actor, finishes: Sequence[UploadFinish], failures: Failures
) -> dict[uuid.UUID, Row[Any]]:
    """Mark uploads as being completed, with the hashes that the client states; note those that cannot be."""
    rows = await queries.locked_uploads(db, actor, [finish.upload_id for finish in finishes])
    marks: dict[uuid.UUID, dict[str, object]] = {}
    for finish in finishes:
        row = rows.get(finish.upload_id)
        error = _unfit(row, finish)
        if error is not None:
            failures[finish.upload_id] = error
        elif row is not None and row.state != UploadState.done.value:
            hashes = {"sha256": bytes.fromhex(finish.sha256), "crc64nvme": bytes.fromhex(finish.crc64nvme)}
            marks[row.id] = {"id": row.id, **hashes}
    if marks:
        said = unnest_rows([upload.c.id, upload.c.sha256, upload.c.crc64nvme], [*marks.values()])
        stated = {"sha256": said.c.sha256, "crc64nvme": said.c.crc64nvme}
        marked = {"state": UploadState.completing.value, "completing_since": func.now(), **stated}
        await db.execute(update(upload).where(upload.c.id == said.c.id).values(**marked))
    ids = dict.fromkeys(finish.upload_id for finish in finishes)
    found = {row.id: row for row in await db.execute(select(upload).where(among(upload.c.id, ids)))}
    # In the order asked: of two that cannot stand side by side, the first comes in.
    return {each: found[each] for each in ids if each in found}


def _unfit(row: Row[Any] | None, finish: UploadFinish) -> KleinkramError | None:
    if row is None:
        return UploadGone(upload_id=str(finish.upload_id))
    if row.failure is not None:
        return from_problem(ProblemDocument.model_validate_json(row.failure))
    if row.state in {UploadState.aborted.value, UploadState.expired.value}:
        return UploadGone(upload_id=str(finish.upload_id))
    if row.state == UploadState.done.value or is_multipart(row):
        return None
    if row.signed_checksum is None:
        return UploadIncomplete(path=row.path, reason="nothing was sent yet")
    named = {ChecksumKind.crc64nvme.value: finish.crc64nvme, ChecksumKind.sha256.value: finish.sha256}.get(row.checksum)
    if named is not None and named != row.signed_checksum:
        return ChecksumMismatch(path=row.path, reason="its checksum was announced differently when it was sent")
    return None


async def _make_files(db: Connection, actor: Actor, mission_id: uuid.UUID, rows: Sequence[Row[Any]]) -> Failures:
    """Make blob and file of each upload, in one transaction with the record and the jobs that follow."""
    try:
        await missions.lock_mission_to_fill(db, actor, mission_id)
    except (NotFound, Forbidden):
        return {row.id: UploadGone(upload_id=str(row.id)) for row in rows}
    # Open, too: another hand that came while the store was joining saw too few parts, and took back the mark.
    unfinished = upload.c.state.in_((UploadState.completing.value, UploadState.open.value))
    locked = select(upload.c.id).where(among(upload.c.id, [row.id for row in rows]), unfinished)
    still = set((await db.execute(locked.order_by(upload.c.id).with_for_update())).scalars())
    rows = [row for row in rows if row.id in still]
    existing = await queries.live_files(db, mission_id, [row.path_key for row in rows])
    paths = [row.path for row in rows]
    met = await path_conflicts(db, mission_id, paths)
    conflicts = as_shown(met, may_read=Scope.read in actor.scopes)
    conflicts |= {paths[place]: other for place, other in first_come(paths).items()}
    failures: Failures = {}
    made: dict[uuid.UUID, uuid.UUID] = {}
    fresh = []
    for row in rows:
        there = existing.get(row.path_key)
        if row.path in conflicts:
            failures[row.id] = PathConflict(path=row.path, other=conflicts[row.path])
        elif there is None or _mends(there, row):
            fresh.append(row)
        elif (there.size_bytes, there.sha256) == (row.size_bytes, row.sha256):
            made[row.id] = there.id  # somebody else linked or moved the same bytes here meanwhile
        else:
            may_read = Scope.read in actor.scopes
            failures[row.id] = FileExists(
                path=row.path,
                existing_sha256=there.sha256.hex() if may_read else None,
                sent_sha256=row.sha256.hex(),
                existing_file_id=str(there.id) if may_read else None,
            )
    made |= await _insert(db, actor, mission_id, fresh, existing)
    await _close(db, mission_id, made)
    return failures


def _mends(there: Row[Any], row: Row[Any]) -> bool:
    return there.state in UNREADABLE and (there.size_bytes, there.sha256) == (row.size_bytes, row.sha256)


async def _insert(
    db: Connection, actor: Actor, mission_id: uuid.UUID, rows: Sequence[Row[Any]], existing: Mapping[str, Row[Any]]
) -> dict[uuid.UUID, uuid.UUID]:
    if not rows:
        return {}
    blob_ids = {row.id: uuid.uuid4() for row in rows}
    await db.execute(insert_rows(blob, [blob_values(row, blob_ids[row.id]) for row in rows]))
    mended = {row.id: existing[row.path_key].id for row in rows if row.path_key in existing}
    for upload_id, file_id in mended.items():
        await db.execute(update(file).where(file.c.id == file_id).values(blob_id=blob_ids[upload_id]))
    new = {row.id: uuid.uuid4() for row in rows if row.id not in mended}
    if new:
        values = [
            {
                "id": new[row.id],
                "mission_id": mission_id,
                "blob_id": blob_ids[row.id],
                "path": row.path,
                "path_key": row.path_key,
                "origin": "upload",
                "uploaded_by_id": row.person_id,
            }
            for row in rows
            if row.id in new
        ]
        await db.execute(insert_rows(file, values))
    made = mended | new
    project_id = (await missions.get_mission_row(db, actor, mission_id)).project_id
    await record_all(
        db,
        actor,
        [
            Event(
                "file.mend" if row.id in mended else "file.upload",
                "file",
                made[row.id],
                row.path,
                project_id,
                after={"size_bytes": row.size_bytes, "sha256": row.sha256.hex()},
                mission_id=mission_id,
            )
            for row in rows
        ],
    )
    await examine_blobs(db, list(blob_ids.values()))
    await regroup(db, mission_id)
    return made


async def _close(db: Connection, mission_id: uuid.UUID, made: Mapping[uuid.UUID, uuid.UUID]) -> None:
    if not made:
        return
    # What a blob does not use (the same bytes came in by another way) is cleaned by the sweep.
    kept = select(blob.c.id).where(blob.c.store_id == upload.c.store_id, blob.c.key == upload.c.key).exists()
    rows = [{"id": upload_id, "file_id": file_id} for upload_id, file_id in made.items()]
    said = unnest_rows([upload.c.id, upload.c.file_id], rows)
    cleaned_at = case((kept, func.now()), else_=upload.c.cleaned_at)
    values = {"state": UploadState.done.value, "file_id": said.c.file_id, "cleaned_at": cleaned_at}
    await db.execute(update(upload).where(upload.c.id == said.c.id).values(**values))
    await publish(db, [ChangeEvent("upload", ChangeKind.removed, each, mission_id=mission_id) for each in made])


async def _note_failures(db: Connection, actor: Actor, failures: Failures, ended: Failures) -> None:
    reopened = [upload_id for upload_id in failures if upload_id not in ended]
    completing = upload.c.state == UploadState.completing.value
    if reopened:
        await db.execute(
            update(upload)
            .where(among(upload.c.id, reopened), completing)
            .values(state=UploadState.open.value, completing_since=None)
        )
    for upload_id, error in ended.items():
        failure = to_problem(error, actor.request_id).model_dump_json()
        values = {"state": UploadState.aborted.value, "failure": failure}
        changed = update(upload).where(upload.c.id == upload_id, completing).values(**values)
        rows = await db.execute(changed.returning(upload.c.id, upload.c.mission_id))
        await publish(
            db, [ChangeEvent("upload", ChangeKind.removed, row.id, mission_id=row.mission_id) for row in rows]
        )


async def finish_cut_off(
    context: AppContext, actor: Actor, *, mission_id: uuid.UUID, wanted: Sequence[UploadFile]
) -> None:
    """Finish those of `actor`'s uploads that were being completed when their client died, and are now gone on with.

    Raises:
        StoreUnavailable: the store cannot be asked what came of them.
    """
    going_on = among(upload.c.id, [each.upload_id for each in wanted if each.upload_id])
    await _finish(context, actor, (upload.c.mission_id == mission_id) & going_on)


async def finish_cut_off_artifacts(
    context: AppContext, actor: Actor, *, run_id: uuid.UUID, paths: Sequence[str]
) -> None:
    """Finish what a run left and its runner was completing when it was killed.

    Raises:
        StoreUnavailable: the store cannot be asked what came of it.
    """
    await _finish(context, actor, (upload.c.run_id == run_id) & among(upload.c.path, paths))


async def _finish(context: AppContext, actor: Actor, which: ColumnElement[bool]) -> None:
    marked = select(upload.c.id).where(which, upload.c.state == UploadState.completing.value)
    async with context.database.autocommit() as db:
        cut = (await db.execute(marked)).scalars().all()  # seldom any: whose they are is asked of these alone
        rows = (await db.execute(queries.own_uploads(actor).where(among(upload.c.id, cut)))).all() if cut else []
    if rows:
        await settle(context, actor, rows)


async def finish_stale(context: AppContext, *, older_than_s: float) -> int:
    """Finish what a crash left between mark and finish; return how many uploads were looked at."""
    before = func.now() - datetime.timedelta(seconds=older_than_s)
    statement = (
        select(upload)
        .where(upload.c.state == UploadState.completing.value, upload.c.completing_since < before)
        .order_by(upload.c.completing_since)
        .limit(500)
    )
    async with context.database.begin() as db:
        rows = (await db.execute(statement)).all()
    for row in rows:
        await _settle_for(context, row)
    return len(rows)


async def _settle_for(context: AppContext, row: Row[Any]) -> None:
    """Take an upload to its end in the name of whoever began it, with the rights that they have now."""
    async with context.database.begin() as db:
        actor = await find_person(db, row.person_id)
        if actor is None:
            left = {"state": UploadState.aborted.value}
            await db.execute(update(upload).where(upload.c.id == row.id).values(**left))
            await publish(db, [ChangeEvent("upload", ChangeKind.removed, row.id, mission_id=row.mission_id)])
    if actor is None:
        return
    try:
        await settle(context, actor.asking("complete_uploads", request_id=None, address=None), [row])
    except KleinkramError as error:  # one that cannot be finished yet does not hold up the others
        _log.warning("upload not finished", extra={"fields": {"upload_id": str(row.id), "reason": str(error)}})
