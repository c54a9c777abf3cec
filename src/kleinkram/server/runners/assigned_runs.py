"""Requests of a runner about a run assigned to it: inputs, log chunks, artifacts, and the end."""

import datetime
import uuid
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, bindparam, func, insert, select, update

from kleinkram.contract.actions import ActionDefinition, ParameterValues
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.errors import Forbidden, NotFound, RunGone
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.runners import (
    ArtifactUploadsCreate,
    InputsRequest,
    InputUrls,
    LogChunkConfirm,
    LogChunkCreate,
    LogChunkUpload,
)
from kleinkram.contract.runs import (
    LOG_BYTES,
    MAX_SAMPLES,
    UsageSample,
)
from kleinkram.contract.uploads import ChecksumKind, UploadDecisions
from kleinkram.server.access.actor import Actor
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among, among_parameter
from kleinkram.server.s3.storage import PartTarget
from kleinkram.server.tables import (
    action,
    action_version,
    blob,
    log_chunk,
    mission,
    run,
    run_input,
    runner,
)
from kleinkram.server.tables.runs import ASSIGNED
from kleinkram.server.uploads.artifacts import ArtifactOwner, begin_artifacts
from kleinkram.server.uploads.completion import finish_interrupted_artifacts

_BATCH = 1000
# A token ends with its run, and at the latest this long after the time limit of the run.
TOKEN_MARGIN = datetime.timedelta(hours=1)
OWN_TOKEN = "a token of its own: `klein token create NAME --kind runner`; to replace one, revoke it first"  # noqa: S105


class AssignedRun(NamedTuple):
    """A run that a runner has, or is about to get. `pinned_digest` is what its image was first resolved to."""

    id: uuid.UUID
    mission_id: uuid.UUID
    version_id: uuid.UUID
    state: str
    attempt: int
    started_by_id: uuid.UUID
    retry_of_id: uuid.UUID | None
    parameters: ParameterValues
    image_digest: str | None
    input_metadata: Metadata | None
    checks_sha256: bytes | None
    traceparent: str | None
    action_name: str
    pinned_digest: str | None
    version_number: int | None
    action_id: uuid.UUID | None
    project_id: uuid.UUID


_RUNS = (
    select(
        *(run.c[name] for name in AssignedRun._fields[:12]),
        action_version.c.definition["name"].astext.label("action_name"),
        action_version.c.image_digest.label("pinned_digest"),
        action_version.c.number,
        action.c.id.label("action_id"),
        mission.c.project_id,
    )
    .join_from(run, mission, mission.c.id == run.c.mission_id)
    .join(action_version, action_version.c.id == run.c.version_id)
    .outerjoin(action, action.c.id == action_version.c.action_id)
    .order_by(run.c.id)
    .with_for_update(of=run, key_share=True)
)
# Built once: a runner with many runs sends these often.
_OF_RUNNER = (run.c.runner_id == bindparam("runner_id")) & run.c.state.in_(ASSIGNED)
_ASSIGNED = _RUNS.where(_OF_RUNNER, among_parameter(run.c.id, "run_ids"))
_UNKNOWN = _RUNS.where(_OF_RUNNER, ~among_parameter(run.c.id, "run_ids")).limit(bindparam("limit"))
_BY_IDS = _RUNS.where(among_parameter(run.c.id, "run_ids"))


async def lock_runs(db: Connection, run_ids: Sequence[uuid.UUID]) -> list[AssignedRun]:
    """Return runs in the order of their ids, locked until this transaction ends."""
    return [AssignedRun._make(row) for row in await db.execute(_BY_IDS, {"run_ids": [*run_ids]})]


async def lock_unknown_runs(
    db: Connection, runner_id: uuid.UUID, known_ids: Sequence[uuid.UUID], *, limit: int
) -> list[AssignedRun]:
    """Return runs that a runner has without knowing it, locked until this transaction ends."""
    values = {"runner_id": runner_id, "run_ids": [*known_ids], "limit": limit}
    return [AssignedRun._make(row) for row in await db.execute(_UNKNOWN, values)]


async def find_definitions(db: Connection, rows: Sequence[AssignedRun]) -> dict[uuid.UUID, ActionDefinition]:
    """Return the definitions of runs by the ids of their versions: each once, since one with its lock is large."""
    stmt = select(action_version.c.id, action_version.c.definition)
    stmt = stmt.where(among(action_version.c.id, {row.version_id for row in rows}))
    return {one.id: ActionDefinition.model_validate(one.definition) for one in await db.execute(stmt)}


async def lock_assigned_runs(db: Connection, actor: Actor, attempts: Mapping[uuid.UUID, int]) -> list[AssignedRun]:
    """Return those runs of a runner that it has by these attempts, locked until this transaction ends."""
    rows = await db.execute(_ASSIGNED, {"runner_id": actor.runner_id, "run_ids": [*attempts]})
    return [AssignedRun._make(row) for row in rows if row.attempt == attempts[row.id]]


def is_of_runner(actor: Actor) -> ColumnElement[bool]:
    """Whether the last attempt at a run belongs to the runner of this token."""
    return run.c.runner_id.is_not(None) & (run.c.runner_id == actor.runner_id)


async def lock_assigned_run(db: Connection, actor: Actor, run_id: uuid.UUID, attempt: int) -> AssignedRun:
    """Return a run of a runner, locked until this transaction ends.

    Raises:
        RunGone: it does not have the run, or this attempt is outdated.
    """
    rows = await lock_assigned_runs(db, actor, {run_id: attempt})
    if not rows:
        raise RunGone(run_id=str(run_id))
    return rows[0]


async def record_seen(db: Connection, actor: Actor, runner_id: uuid.UUID) -> int:
    """Record that a runner was seen; return the length of its leases in seconds.

    Raises:
        NotFound: this person has no such runner.
        Forbidden: the token is another runner's.
    """
    mine = (runner.c.id == runner_id) & (runner.c.person_id == actor.person_id)
    stmt = update(runner).where(mine).values(last_seen_at=func.now(), token_id=actor.token_id)
    lease_s: int | None = (await db.execute(stmt.returning(runner.c.lease_s))).scalar_one_or_none()
    if lease_s is None:
        raise NotFound(resource_type="runner", ref=str(runner_id))
    if actor.runner_id != runner_id:
        raise Forbidden(resource_type="server", operation="be this runner", needs=OWN_TOKEN)
    return lease_s


def require_own(actor: Actor, runner_id: uuid.UUID) -> None:
    """Check that a token is a runner's own. Raises NotFound."""
    if actor.runner_id != runner_id:
        raise NotFound(resource_type="runner", ref=str(runner_id))


async def pin_images(db: Connection, digests: Mapping[uuid.UUID, str]) -> None:
    """Pin the images of versions of actions, unless they are pinned: the first resolution of a name is permanent."""
    # In one order, so that two runners cannot deadlock.
    for version_id, digest in sorted(digests.items()):
        is_unpinned = action_version.c.image_digest.is_(None) & action_version.c.definition["image"].astext.is_not(None)
        stmt = update(action_version).where(action_version.c.id == version_id, is_unpinned)
        await db.execute(stmt.values(image_digest=digest))


def token_lifetime(definition: ActionDefinition) -> datetime.timedelta:
    """Return how long the token of a run is valid from its claim; heartbeats extend that."""
    return datetime.timedelta(seconds=definition.resources.time_s) + TOKEN_MARGIN


def thinned(stored: list[dict[str, Any]], new: Sequence[UsageSample]) -> list[dict[str, Any]]:
    """Return at most `MAX_SAMPLES` samples: of more, every second one and the last."""
    samples = [*stored, *(entry.model_dump(mode="json") for entry in new)]
    while len(samples) > MAX_SAMPLES:
        samples = [*samples[:-1:2], samples[-1]]
    return samples


async def sign_inputs(context: AppContext, actor: Actor, *, run_id: uuid.UUID, requested: InputsRequest) -> InputUrls:
    """Return URLs of inputs, in the requested order.

    Raises:
        RunGone: the runner does not have the run by this attempt.
        NotFound: the run has no such input, or its content no longer exists.
    """
    async with context.database.begin() as db:
        await lock_assigned_run(db, actor, run_id, requested.attempt)
        joined = select(run_input.c.path, blob.c.key).join_from(run_input, blob, blob.c.id == run_input.c.blob_id)
        selected = joined.where(run_input.c.run_id == run_id, among(run_input.c.path, requested.paths))
        keys = {row.path: row.key for row in await db.execute(selected)}
    for path in requested.paths:
        if path not in keys:
            raise NotFound(resource_type="input", ref=path)
    expires_s = context.settings.download_url_s
    expires_at = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=expires_s)
    urls = [context.storage.sign_get(keys[path], path=path, expires_s=expires_s) for path in requested.paths]
    return InputUrls(urls=urls, expires_at=expires_at)


async def create_log_chunk(
    context: AppContext, actor: Actor, *, run_id: uuid.UUID, requested: LogChunkCreate
) -> LogChunkUpload:
    """Return a URL for a chunk of the log; a repeated request returns another one, as long as none is confirmed.

    Raises:
        RunGone: the runner does not have the run by this attempt, or the log is too long.
    """
    if requested.offset > LOG_BYTES:
        raise RunGone(run_id=str(run_id))
    key = f"runs/{run_id}/{requested.attempt}/log/{requested.offset:012}-{uuid.uuid4().hex[:8]}"
    async with context.database.begin() as db:
        await lock_assigned_run(db, actor, run_id, requested.attempt)
        values = {"run_id": run_id, "attempt": requested.attempt, "offset_bytes": requested.offset}
        stmt = insert(log_chunk).values(
            key=key, store_id=context.settings.store_id, size_bytes=requested.size_bytes, **values
        )
        await db.execute(stmt)
    kind = context.storage.checksum
    checksum = {
        ChecksumKind.sha256: requested.sha256,
        ChecksumKind.crc64nvme: requested.crc64nvme,
        ChecksumKind.md5: requested.md5,
    }
    target = PartTarget(key, None, 1, requested.size_bytes, checksum[kind])
    signed = context.storage.sign_part(target, expires_s=context.settings.part_url_s)
    return LogChunkUpload(url=signed.url, headers=signed.headers)


async def confirm_log_chunk(db: Connection, actor: Actor, *, run_id: uuid.UUID, confirmed: LogChunkConfirm) -> None:
    """Make an uploaded chunk visible. Chunks come in order; a visible one stays.

    Raises:
        RunGone: the runner does not have the run by this attempt.
    """
    row = await lock_assigned_run(db, actor, run_id, confirmed.attempt)
    same = (log_chunk.c.run_id == run_id) & (log_chunk.c.attempt == confirmed.attempt)
    shown = select(log_chunk.c.key).where(
        same, log_chunk.c.confirmed_at.is_not(None), log_chunk.c.offset_bytes >= confirmed.offset
    )
    if (await db.execute(shown.limit(1))).first() is not None:
        return
    here = same & (log_chunk.c.offset_bytes == confirmed.offset) & (log_chunk.c.size_bytes == confirmed.size_bytes)
    latest = select(log_chunk.c.key).where(here).order_by(log_chunk.c.created_at.desc()).limit(1)
    stmt = update(log_chunk).where(log_chunk.c.key.in_(latest)).values(confirmed_at=func.now())
    await db.execute(stmt)
    await publish(db, [ChangeEvent("run_log", ChangeKind.changed, run_id, mission_id=row.mission_id)])


async def create_artifact_uploads(
    context: AppContext, actor: Actor, *, run_id: uuid.UUID, requested: ArtifactUploadsCreate
) -> UploadDecisions:
    """Begin uploads of artifacts, after finishing those of the same paths that were interrupted.

    Raises:
        RunGone: the runner does not have the run by this attempt.
    """
    async with context.database.begin() as db:
        row = await lock_assigned_run(db, actor, run_id, requested.attempt)
    owner = ArtifactOwner(run_id, row.mission_id, row.started_by_id)
    await finish_interrupted_artifacts(context, actor, run_id=run_id, paths=[entry.path for entry in requested.files])
    return UploadDecisions(items=await begin_artifacts(context, actor, owner=owner, requested=requested.files))
