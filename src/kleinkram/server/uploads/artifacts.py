"""The upload protocol for artifacts of a run, which only its runner may upload."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import func, insert, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.errors import FileExists, RunGone, StoreUnavailable, UploadGone
from kleinkram.contract.files import ContentState
from kleinkram.contract.problems import to_problem
from kleinkram.contract.runners import LOG_PATH
from kleinkram.contract.uploads import (
    AlreadyPresent,
    StoredPart,
    UploadDecision,
    UploadFile,
    UploadRefused,
    UploadRequired,
    UploadState,
)
from kleinkram.server.access.actor import Actor
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.jobs.queue import Job, Priority, enqueue
from kleinkram.server.tables import blob, run, run_artifact, upload
from kleinkram.server.tables.blobs import UNDER_WAY
from kleinkram.server.tables.runs import ASSIGNED
from kleinkram.server.uploads import queries
from kleinkram.server.uploads.parts import (
    Failures,
    blob_columns,
    free_names,
    lease_columns,
    open_multiparts,
    to_upload_read,
    upload_columns,
)
from kleinkram.server.uploads.queries import UploadRow


@dataclass(frozen=True)
class ArtifactOwner:
    """The run that artifacts belong to: its mission, and the person who started it."""

    run_id: uuid.UUID
    mission_id: uuid.UUID
    started_by_id: uuid.UUID


async def begin_artifacts(
    context: AppContext, actor: Actor, *, owner: ArtifactOwner, requested: Sequence[UploadFile]
) -> list[UploadDecision]:
    """Open uploads of a run's artifacts; one that the run already has, with the same hash, is not sent again.

    Idempotent: repeated, an upload continues where it was.

    Raises:
        RunGone: the run is not active.
    """
    async with context.database.begin() as db:
        if not await _lock_active_run(db, owner.run_id):
            raise RunGone(run_id=str(owner.run_id))
        hashes = await _existing_hashes(db, owner.run_id, [file.path for file in requested])
        missing = [file for file in requested if file.path not in hashes]
        continued = await _continue_uploads(db, context, owner.run_id, missing)
        new = await _insert_uploads(db, context, owner, [file for file in missing if file.path not in continued])
        ids = [*continued.values(), *new]
        uploads = await queries.read_rows(db, queries.select_uploads().where(among(upload.c.id, ids)))
    multipart = [row for row in uploads if row.is_multipart]
    try:
        parts = await open_multiparts(context, multipart, resumed=set(continued.values())) if multipart else {}
    except StoreUnavailable:
        await free_names(context, new)
        raise
    by_path = {row.path: row for row in uploads}
    return [_to_wire(actor, file, hashes.get(file.path), by_path.get(file.path), parts) for file in requested]


async def _lock_active_run(db: Connection, run_id: uuid.UUID) -> bool:
    active = select(run.c.id).where(run.c.id == run_id, run.c.state.in_(ASSIGNED)).with_for_update(key_share=True)
    return (await db.execute(active)).first() is not None


async def _existing_hashes(db: Connection, run_id: uuid.UUID, paths: Sequence[str]) -> dict[str, str]:
    """Return by path the SHA-256 of artifacts that the run has, its log among them."""
    artifacts = select(run_artifact.c.path, blob.c.sha256).join_from(run_artifact, blob)
    artifacts = artifacts.where(run_artifact.c.run_id == run_id, among(run_artifact.c.path, paths))
    hashes = {row.path: row.sha256.hex() for row in await db.execute(artifacts)}
    log = select(blob.c.sha256).join_from(run, blob, blob.c.id == run.c.log_blob_id).where(run.c.id == run_id)
    log_sha256 = (await db.execute(log)).scalar_one_or_none()
    return hashes if log_sha256 is None else {**hashes, LOG_PATH: log_sha256.hex()}


async def _continue_uploads(
    db: Connection, context: AppContext, run_id: uuid.UUID, requested: Sequence[UploadFile]
) -> dict[str, uuid.UUID]:
    """Renew the leases of this run's open uploads and return them by path; end those of another size."""
    sizes = {file.path: file.size_bytes for file in requested}
    is_open = (upload.c.run_id == run_id) & upload.c.state.in_(UNDER_WAY)
    opened = await queries.read_rows(db, queries.select_uploads().where(is_open, among(upload.c.path, sizes)))
    outdated = [row.id for row in opened if row.size_bytes != sizes[row.path]]
    if outdated:
        await db.execute(update(upload).where(among(upload.c.id, outdated)).values(state=UploadState.aborted.value))
    continued = {row.path: row.id for row in opened if row.id not in outdated}
    if continued:
        renewed = lease_columns(context.settings, func.now())
        await db.execute(update(upload).where(among(upload.c.id, continued.values())).values(**renewed))
    return continued


async def _insert_uploads(
    db: Connection, context: AppContext, owner: ArtifactOwner, requested: Sequence[UploadFile]
) -> list[uuid.UUID]:
    if not requested:
        return []
    now = (await db.execute(select(func.now()))).scalar_one()
    batch_id = uuid.uuid4()
    rows = [
        {**upload_columns(context, owner.started_by_id, owner.mission_id, batch_id, file, now), "run_id": owner.run_id}
        for file in requested
    ]
    return list((await db.execute(upsert(upload).returning(upload.c.id), rows)).scalars())


def _to_wire(
    actor: Actor,
    requested: UploadFile,
    existing_sha256: str | None,
    row: UploadRow | None,
    parts: Mapping[uuid.UUID, list[StoredPart]],
) -> UploadDecision:
    if row is not None:
        return UploadRequired(upload=to_upload_read(row, parts.get(row.id, [])))
    if requested.sha256 in {None, existing_sha256}:
        return AlreadyPresent(file=None)
    error = FileExists(
        path=requested.path, existing_sha256=existing_sha256, sent_sha256=requested.sha256 or "", existing_file_id=None
    )
    return UploadRefused(path=requested.path, problem=to_problem(error, actor.request_id))


async def make_artifacts(db: Connection, run_id: uuid.UUID, uploads: Sequence[UploadRow]) -> Failures:
    """Make the blob and artifact of each complete upload; all are UploadGone if the run is not active."""
    if not await _lock_active_run(db, run_id):
        return {row.id: UploadGone(upload_id=str(row.id)) for row in uploads}
    unfinished = await queries.lock_unfinished(db, uploads)
    if not unfinished:
        return {}
    blob_ids = {row.id: uuid.uuid4() for row in unfinished}
    # Read as a recording only if it becomes a file of the mission.
    unread = {"content": ContentState.opaque.value, "summarised_at": func.now()}
    blobs = [blob_columns(row, blob_ids[row.id]) for row in unfinished]
    await db.execute(insert(blob).values(**unread), blobs)
    artifacts = [
        {"id": uuid.uuid4(), "run_id": run_id, "path": row.path, "blob_id": blob_ids[row.id]}
        for row in unfinished
        if row.path != LOG_PATH
    ]
    if artifacts:
        await db.execute(insert(run_artifact), artifacts)
    for row in unfinished:
        if row.path == LOG_PATH:
            await db.execute(update(run).where(run.c.id == run_id).values(log_blob_id=blob_ids[row.id]))
    done = {"state": UploadState.done.value, "cleaned_at": func.now()}
    await db.execute(update(upload).where(among(upload.c.id, blob_ids)).values(**done))
    await enqueue(db, Job.verify_blob, ids=[str(id_) for id_ in blob_ids.values()], priority=Priority.normal)
    return {}
