"""What runs leave comes in by the upload protocol too: to the run, under paths of its own, and nobody else's."""

import uuid
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Row, func, insert, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.errors import FileExists, RunGone, StoreUnavailable, UploadGone
from kleinkram.contract.files import ContentState
from kleinkram.contract.problems import to_problem
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.uploads import HeldPart, Present, Refused, Send, UploadDecision, UploadFile, UploadState
from kleinkram.server.access.actor import Actor
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.jobs.queue import Job, Urgency, enqueue
from kleinkram.server.tables import blob, run, run_artifact, upload
from kleinkram.server.tables.run import HELD
from kleinkram.server.tables.upload import UNDER_WAY
from kleinkram.server.uploads.joining import Failures
from kleinkram.server.uploads.rules import blob_values
from kleinkram.server.uploads.service import let_go, new_upload, open_at_store, read_upload
from kleinkram.server.uploads.signing_parts import is_multipart, renewed


async def begin_artifacts(
    context: AppContext, actor: Actor, *, row: Row[Any], wanted: Sequence[UploadFile]
) -> list[UploadDecision]:
    """Open uploads of what the run `row` left; one that is there already, with the same hash, is not sent again.

    Idempotent: asked again, an upload goes on where it was.
    """
    paths = [each.path for each in wanted]
    async with context.database.begin() as db:
        await _see_that_it_is_held(db, row.id)
        there = await _there(db, row.id, paths)
        fresh = [each for each in wanted if each.path not in there]
        ids, begun = await _hold(db, context, row, fresh)
        rows = await _uploads(db, ids)
    try:
        multipart = [each for each in rows.values() if is_multipart(each)]
        parts = await open_at_store(context, multipart, resumed=set(ids) - set(begun)) if multipart else {}
    except StoreUnavailable:
        await let_go(context, begun)
        raise
    by_path = {each.path: each for each in rows.values()}
    return [_answer(actor, each, there.get(each.path), by_path.get(each.path), parts) for each in wanted]


async def _see_that_it_is_held(db: Connection, run_id: uuid.UUID) -> None:
    held = select(run.c.id).where(run.c.id == run_id, run.c.state.in_(HELD)).with_for_update(key_share=True)
    if (await db.execute(held)).first() is None:
        raise RunGone(run_id=str(run_id))


async def _there(db: Connection, run_id: uuid.UUID, paths: Sequence[str]) -> dict[str, str]:
    """Return the hashes of what the run's artifacts hold already."""
    stmt = select(run_artifact.c.path, blob.c.sha256).join_from(run_artifact, blob)
    found = stmt.where(run_artifact.c.run_id == run_id, among(run_artifact.c.path, paths))
    there = {row.path: row.sha256.hex() for row in await db.execute(found)}
    log = select(blob.c.sha256).join_from(run, blob, blob.c.id == run.c.log_blob_id).where(run.c.id == run_id)
    kept = (await db.execute(log)).scalar_one_or_none()
    return there if kept is None else {**there, LOG_PATH: kept.hex()}


async def _hold(
    db: Connection, context: AppContext, row: Row[Any], wanted: Sequence[UploadFile]
) -> tuple[list[uuid.UUID], list[uuid.UUID]]:
    """Return the uploads of each path that is wanted, and those of them that were begun now."""
    if not wanted:
        return [], []
    now = (await db.execute(select(func.now()))).scalar_one()
    batch = uuid.uuid4()
    same = (upload.c.run_id == row.id) & upload.c.state.in_(UNDER_WAY)
    held = await db.execute(select(upload).where(same, among(upload.c.path, [each.path for each in wanted])))
    known = {each.path: each for each in held}
    sizes = {each.path: each.size_bytes for each in wanted}
    other = [each.id for each in known.values() if each.size_bytes != sizes[each.path]]
    ended = update(upload).where(among(upload.c.id, other))
    await db.execute(ended.values(state=UploadState.aborted.value))
    kept = [each.id for each in known.values() if each.id not in other]
    await db.execute(update(upload).where(among(upload.c.id, kept)).values(**renewed(context.settings, now)))
    going_on = {each.path for each in known.values() if each.id in kept}
    values = [
        {**new_upload(context, row.started_by_id, row.mission_id, batch, each, now), "run_id": row.id}
        for each in wanted
        if each.path not in going_on
    ]
    begun: list[uuid.UUID] = []
    if values:
        begun = list((await db.execute(upsert(upload).returning(upload.c.id), values)).scalars())
    return [*kept, *begun], begun


async def _uploads(db: Connection, ids: Sequence[uuid.UUID]) -> dict[uuid.UUID, Row[Any]]:
    return {row.id: row for row in await db.execute(select(upload).where(among(upload.c.id, ids)))}


def _answer(
    actor: Actor,
    wanted: UploadFile,
    there: str | None,
    row: Row[Any] | None,
    parts: Mapping[uuid.UUID, list[HeldPart]],
) -> UploadDecision:
    if row is not None:
        return Send(upload=read_upload(row, parts.get(row.id, [])))
    if wanted.sha256 in {None, there}:
        return Present(file=None)
    error = FileExists(path=wanted.path, existing_sha256=there, sent_sha256=wanted.sha256 or "", existing_file_id=None)
    return Refused(path=wanted.path, problem=to_problem(error, actor.request_id))


async def make_artifacts(db: Connection, run_id: uuid.UUID, rows: Sequence[Row[Any]]) -> Failures:
    """Make blob and artifact of each upload that the store has whole, while the run is held; else they are gone."""
    held = select(run.c.id).where(run.c.id == run_id, run.c.state.in_(HELD)).with_for_update(key_share=True)
    if (await db.execute(held)).first() is None:
        return {row.id: UploadGone(upload_id=str(row.id)) for row in rows}
    unfinished = upload.c.state.in_((UploadState.completing.value, UploadState.open.value))
    locked = select(upload.c.id).where(among(upload.c.id, [row.id for row in rows]), unfinished)
    still = set((await db.execute(locked.order_by(upload.c.id).with_for_update())).scalars())
    rows = [row for row in rows if row.id in still]
    if not rows:
        return {}
    blob_ids = {row.id: uuid.uuid4() for row in rows}
    # Nobody reads these as recordings, unless one becomes a file of the mission.
    unread = {"content": ContentState.opaque.value, "summarised_at": func.now()}
    await db.execute(insert(blob).values(**unread), [blob_values(row, blob_ids[row.id]) for row in rows])
    artifacts = [
        {"id": uuid.uuid4(), "run_id": run_id, "path": row.path, "blob_id": blob_ids[row.id]}
        for row in rows
        if row.path != LOG_PATH
    ]
    if artifacts:
        await db.execute(insert(run_artifact), artifacts)
    for row in rows:
        if row.path == LOG_PATH:
            await db.execute(update(run).where(run.c.id == run_id).values(log_blob_id=blob_ids[row.id]))
    done = update(upload).where(among(upload.c.id, blob_ids))
    await db.execute(done.values(state=UploadState.done.value, cleaned_at=func.now()))
    await enqueue(db, Job.verify_blob, ids=[str(each) for each in blob_ids.values()], urgency=Urgency.whenever)
    return {}
