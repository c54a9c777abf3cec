"""Requests of a runner about one of its runs: inputs, log chunks, and the end."""

import datetime
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Row, func, insert, select, update

from kleinkram.contract.access import Right
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.errors import KleinkramError, NotFound, RunGone
from kleinkram.contract.files import ContentState
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.reports import PutBack, Report, Severity
from kleinkram.contract.runners import (
    InputsRequest,
    InputUrls,
    LogChunkConfirm,
    LogChunkCreate,
    LogChunkUpload,
    RunFinish,
    RunFinished,
)
from kleinkram.contract.runs import LOG_BYTES, ActionRef, Cause, EndReason, RunContext, RunState
from kleinkram.contract.uploads import ChecksumKind
from kleinkram.server.access.actor import Actor, find_person
from kleinkram.server.access.visible import visible_files
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs.service import examine_blobs
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.files import queries as files
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.files.queries import to_topics, topic_rows
from kleinkram.server.missions import service as missions
from kleinkram.server.quotas import Amount, require_room
from kleinkram.server.recordings import queries as recordings
from kleinkram.server.recordings.service import regroup
from kleinkram.server.runners import queries
from kleinkram.server.runners.service import thinned
from kleinkram.server.runs.lifecycle import end_run
from kleinkram.server.s3.storage import PartTarget
from kleinkram.server.tables import (
    blob,
    file,
    log_chunk,
    run,
    run_artifact,
    run_finding,
    run_input,
    run_metric,
)

_BATCH = 1000


async def lock_assigned_run(db: Connection, actor: Actor, run_id: uuid.UUID, attempt: int) -> Row[Any]:
    """Return a run of a runner, locked until this transaction ends.

    Raises:
        RunGone: it does not have the run, or this attempt is outdated.
    """
    row = (await db.execute(queries.assigned_run(actor, run_id, attempt))).one_or_none()
    if row is None:
        raise RunGone(run_id=str(run_id))
    return row


async def get_context(db: Connection, actor: Actor, *, run_id: uuid.UUID, attempt: int) -> RunContext:
    """Return the content of `/in/mission.json`, with the files that still exist.

    Raises:
        RunGone: the runner does not have the run by this attempt.
    """
    row = await lock_assigned_run(db, actor, run_id, attempt)
    starter = await find_person(db, row.started_by_id)
    if starter is None:
        raise RunGone(run_id=str(run_id))
    try:
        place = await missions.get_mission(db, starter, row.mission_id)
    except NotFound:
        raise RunGone(run_id=str(run_id)) from None
    input_ids = select(run_input.c.file_id).where(run_input.c.run_id == run_id, run_input.c.file_id.is_not(None))
    seen = visible_files(starter).where(file.c.id.in_(input_ids)).order_by(file.c.path)
    topics = await db.execute(topic_rows(visible_files(starter).where(file.c.id.in_(input_ids))))
    named = recordings.recordings_of(starter, row.mission_id)
    return RunContext(
        run_id=run_id,
        action=ActionRef(id=row.action_id, name=row.definition["name"], version=row.number),
        parameters=row.parameters,
        cause=Cause(person=starter.ref, retry_of_id=row.retry_of_id),
        mission=place,
        files=files.to_files((await db.execute(files.file_rows(seen))).all()),
        topics=to_topics(topics.all()),
        recordings=[recordings.to_recording(entry) for entry in await db.execute(named)],
    )


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
            raise NotFound(noun="input", ref=path)
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
    await lock_assigned_run(db, actor, run_id, confirmed.attempt)
    same = (log_chunk.c.run_id == run_id) & (log_chunk.c.attempt == confirmed.attempt)
    shown = select(log_chunk.c.key).where(
        same, log_chunk.c.kept_at.is_not(None), log_chunk.c.offset_bytes >= confirmed.offset
    )
    if (await db.execute(shown.limit(1))).first() is not None:
        return
    here = same & (log_chunk.c.offset_bytes == confirmed.offset) & (log_chunk.c.size_bytes == confirmed.size_bytes)
    latest = select(log_chunk.c.key).where(here).order_by(log_chunk.c.created_at.desc()).limit(1)
    stmt = update(log_chunk).where(log_chunk.c.key.in_(latest)).values(kept_at=func.now())
    await db.execute(stmt)
    row = (await db.execute(select(run.c.mission_id).where(run.c.id == run_id))).one()
    await publish(db, [ChangeEvent("run_log", ChangeKind.changed, run_id, mission_id=row.mission_id)])


async def finish_run(db: Connection, actor: Actor, *, run_id: uuid.UUID, finish: RunFinish) -> RunFinished:
    """Record the end of a run, with its report. Idempotent.

    Raises:
        RunGone: the runner does not have the run by this attempt, and did not end it.
    """
    over = (await db.execute(queries.ended_run(actor, run_id, finish.attempt))).scalar_one_or_none()
    if over is not None:
        return RunFinished(state=RunState(over))
    row = await lock_assigned_run(db, actor, run_id, finish.attempt)
    problems = list(finish.problems)
    artifacts = await _artifacts(db, run_id)
    if finish.reason is EndReason.done:
        problems += await put_back(db, row, finish.report.put_back, artifacts)
    if finish.image_digest is not None and row.definition.get("image") is not None:
        await db.execute(queries.pin_image(row.version_id, finish.image_digest))
    await _store_report(db, run_id, finish.report)
    samples = thinned([*row.samples, *(entry.model_dump(mode="json") for entry in finish.samples)])
    values = {
        "problems": problems[:200],
        "exit_code": finish.exit_code,
        "proposed": finish.report.metadata,
        "previews": [entry.model_dump(mode="json") for entry in finish.report.previews if entry.path in artifacts],
        "artifact_count": len(artifacts),
        "metric_count": len(finish.report.metrics),
        "finding_counts": _finding_counts(finish.report),
        "image_digest": row.image_digest or finish.image_digest,
        "samples": samples,
        "usage": row.usage if finish.usage is None else finish.usage.model_dump(mode="json"),
    }
    await end_run(db, row, finish.reason, finish.message, **values)
    state = (await db.execute(select(run.c.state).where(run.c.id == run_id))).scalar_one()
    name = row.definition["name"]
    after: Metadata = {"reason": finish.reason.value, "artifacts": len(artifacts)}
    event = Event("run.end", "run", run_id, name, row.project_id, after=after, mission_id=row.mission_id)
    await audit(db, actor, event)
    return RunFinished(state=RunState(state))


async def _artifacts(db: Connection, run_id: uuid.UUID) -> dict[str, Row[Any]]:
    stmt = select(run_artifact, blob.c.size_bytes, blob.c.sha256).join_from(run_artifact, blob)
    return {row.path: row for row in await db.execute(stmt.where(run_artifact.c.run_id == run_id))}


async def _store_report(db: Connection, run_id: uuid.UUID, report: Report) -> None:
    findings = [{"run_id": run_id, **entry.model_dump(mode="json")} for entry in report.findings]
    metrics = [{"run_id": run_id, **entry.model_dump(mode="json")} for entry in report.metrics]
    for table, rows in ((run_finding, findings), (run_metric, metrics)):
        for first in range(0, len(rows), _BATCH):
            await db.execute(insert(table), rows[first : first + _BATCH])


def _finding_counts(report: Report) -> Mapping[str, int]:
    counts = {severity.value: 0 for severity in Severity}
    for entry in report.findings:
        counts[entry.severity.value] += 1
    return {severity: count for severity, count in counts.items() if count}


async def put_back(
    db: Connection, row: Row[Any], selected: Sequence[PutBack], artifacts: Mapping[str, Row[Any]]
) -> list[str]:
    """Create files of the mission from artifacts of a run; return sentences about those that could not be created.

    Existing files are never changed. The actor is the person who launched the run, with their current rights.
    """
    selected = [entry for entry in selected if entry.path in artifacts]
    if not selected:
        return []
    most = Right(row.definition["right"])
    starter = await find_person(db, row.started_by_id)
    if starter is None or most.level < Right.create.level:
        return ["It put files back, which requires an action with `right: CREATE`; they stay artifacts."]
    actor = replace(starter.for_request("begin_uploads", request_id=None, address=None), max_right=most)
    try:
        await missions.lock_mission_to_fill(db, actor, row.mission_id)
        size_bytes = sum(artifacts[entry.path].size_bytes for entry in selected)
        await require_room(db, actor, project_id=row.project_id, requested=Amount(len(selected), size_bytes))
    except KleinkramError as error:
        return [f"What it put back stays among the artifacts: {error}"]
    problems, made = await _create_files(db, row, selected, artifacts)
    if made:
        name = row.definition["name"]
        events = [
            Event(
                "file.put_back",
                "file",
                file_id,
                path,
                row.project_id,
                after={"run_id": str(row.id), "action": name},
                mission_id=row.mission_id,
            )
            for path, file_id in made.items()
        ]
        await audit(db, actor, *events)
        await regroup(db, row.mission_id)
    return problems


async def _create_files(
    db: Connection, row: Row[Any], selected: Sequence[PutBack], artifacts: Mapping[str, Row[Any]]
) -> tuple[list[str], dict[str, uuid.UUID]]:
    problems, made = [], {}
    for entry in selected:
        try:
            await check_path_free(db, row.mission_id, entry.to)
        except KleinkramError as error:
            problems.append(f"{entry.path} was not put back: {error}")
            continue
        made[entry.to] = await _create_file(db, row, entry, artifacts[entry.path])
    return problems, made


async def _create_file(db: Connection, row: Row[Any], selected: PutBack, artifact: Row[Any]) -> uuid.UUID:
    file_id = uuid.uuid4()
    values = {"mission_id": row.mission_id, "blob_id": artifact.blob_id, "uploaded_by_id": row.started_by_id}
    place = {"path": selected.to, "path_key": name_key(selected.to), "origin": "run"}
    await db.execute(insert(file).values(id=file_id, **values, **place))
    lineage = {"file_id": file_id, "made_from": selected.made_from}
    await db.execute(update(run_artifact).where(run_artifact.c.id == artifact.id).values(**lineage))
    # Artifacts are not examined; as a file it may be a recording.
    unread = {"content": ContentState.pending.value, "summarised_at": None}
    await db.execute(update(blob).where(blob.c.id == artifact.blob_id).values(**unread))
    await examine_blobs(db, [artifact.blob_id])
    return file_id
