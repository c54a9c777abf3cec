"""What a runner is given and gives of a run that it holds: inputs, the log as it grows, and how it ended."""

import datetime
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Row, func, insert, select, update

from kleinkram.contract.errors import KleinkramError, NotFound, RunGone
from kleinkram.contract.events import ChangeKind
from kleinkram.contract.files import ContentState
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.reports import PutBack, Report, Severity
from kleinkram.contract.rights import Right
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
from kleinkram.server.audit.service import Event, record, record_all
from kleinkram.server.blobs.service import examine_blobs
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.files import queries as files
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.files.topics import to_topics, topic_rows
from kleinkram.server.missions import service as missions
from kleinkram.server.quotas.service import Amount, require_room
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

_AT_ONCE = 1000


async def hold(db: Connection, actor: Actor, run_id: uuid.UUID, attempt: int) -> Row[Any]:
    """Return a run that a runner holds, locked until this transaction ends.

    Raises:
        RunGone: it holds no such run, or not by this attempt any more.
    """
    row = (await db.execute(queries.assigned_run(actor, run_id, attempt))).one_or_none()
    if row is None:
        raise RunGone(run_id=str(run_id))
    return row


async def get_context(db: Connection, actor: Actor, *, run_id: uuid.UUID, attempt: int) -> RunContext:
    """Return what a run is told of itself, its mission and its files; of these as far as they are still there.

    Raises:
        RunGone: the runner does not hold the run by this attempt.
    """
    row = await hold(db, actor, run_id, attempt)
    starter = await find_person(db, row.started_by_id)
    if starter is None:
        raise RunGone(run_id=str(run_id))
    try:
        place = await missions.get_mission(db, starter, row.mission_id)
    except NotFound:
        raise RunGone(run_id=str(run_id)) from None
    given = select(run_input.c.file_id).where(run_input.c.run_id == run_id, run_input.c.file_id.is_not(None))
    seen = visible_files(starter).where(file.c.id.in_(given)).order_by(file.c.path)
    topics = await db.execute(topic_rows(visible_files(starter).where(file.c.id.in_(given))))
    named = recordings.recordings_of(starter, row.mission_id)
    return RunContext(
        run_id=run_id,
        action=ActionRef(id=row.action_id, name=row.definition["name"], version=row.number),
        parameters=row.parameters,
        cause=Cause(person=starter.ref, retry_of_id=row.retry_of_id),
        mission=place,
        files=files.to_files((await db.execute(files.file_rows(seen))).all()),
        topics=to_topics(topics.all()),
        recordings=[recordings.to_recording(each) for each in await db.execute(named)],
    )


async def sign_inputs(context: AppContext, actor: Actor, *, run_id: uuid.UUID, asked: InputsRequest) -> InputUrls:
    """Return where a runner reads inputs, in the order asked.

    Raises:
        RunGone: the runner does not hold the run by this attempt.
        NotFound: the run has no such input, or its bytes are no longer there.
    """
    async with context.database.begin() as db:
        await hold(db, actor, run_id, asked.attempt)
        joined = select(run_input.c.path, blob.c.key).join_from(run_input, blob, blob.c.id == run_input.c.blob_id)
        wanted = joined.where(run_input.c.run_id == run_id, among(run_input.c.path, asked.paths))
        keys = {row.path: row.key for row in await db.execute(wanted)}
    for path in asked.paths:
        if path not in keys:
            raise NotFound(noun="input", ref=path)
    expires_s = context.settings.download_url_s
    expires_at = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(seconds=expires_s)
    urls = [context.storage.sign_get(keys[path], path=path, expires_s=expires_s) for path in asked.paths]
    return InputUrls(urls=urls, expires_at=expires_at)


async def create_log_chunk(
    context: AppContext, actor: Actor, *, run_id: uuid.UUID, asked: LogChunkCreate
) -> LogChunkUpload:
    """Return where a runner stores a piece of a log. Asked again, the piece may go to another place: none is shown yet.

    Raises:
        RunGone: the runner does not hold the run by this attempt, or the log would be longer than logs may be.
    """
    if asked.offset > LOG_BYTES:
        raise RunGone(run_id=str(run_id))
    key = f"runs/{run_id}/{asked.attempt}/log/{asked.offset:012}-{uuid.uuid4().hex[:8]}"
    async with context.database.begin() as db:
        await hold(db, actor, run_id, asked.attempt)
        values = {"run_id": run_id, "attempt": asked.attempt, "offset_bytes": asked.offset}
        stmt = insert(log_chunk).values(
            key=key, store_id=context.settings.store_id, size_bytes=asked.size_bytes, **values
        )
        await db.execute(stmt)
    kind = context.storage.checksum
    checksum = {ChecksumKind.sha256: asked.sha256, ChecksumKind.crc64nvme: asked.crc64nvme, ChecksumKind.md5: asked.md5}
    target = PartTarget(key, None, 1, asked.size_bytes, checksum[kind])
    signed = context.storage.sign_part(target, expires_s=context.settings.part_url_s)
    return LogChunkUpload(url=signed.url, headers=signed.headers)


async def confirm_log_chunk(db: Connection, actor: Actor, *, run_id: uuid.UUID, kept: LogChunkConfirm) -> None:
    """Show a piece of a log that was stored. Pieces come one after the other; one that is shown already stays.

    Raises:
        RunGone: the runner does not hold the run by this attempt.
    """
    await hold(db, actor, run_id, kept.attempt)
    same = (log_chunk.c.run_id == run_id) & (log_chunk.c.attempt == kept.attempt)
    shown = select(log_chunk.c.key).where(
        same, log_chunk.c.kept_at.is_not(None), log_chunk.c.offset_bytes >= kept.offset
    )
    if (await db.execute(shown.limit(1))).first() is not None:
        return
    here = same & (log_chunk.c.offset_bytes == kept.offset) & (log_chunk.c.size_bytes == kept.size_bytes)
    latest = select(log_chunk.c.key).where(here).order_by(log_chunk.c.created_at.desc()).limit(1)
    stmt = update(log_chunk).where(log_chunk.c.key.in_(latest)).values(kept_at=func.now())
    await db.execute(stmt)
    row = (await db.execute(select(run.c.mission_id).where(run.c.id == run_id))).one()
    await publish(db, [ChangeEvent("run_log", ChangeKind.changed, run_id, mission_id=row.mission_id)])


async def finish_run(db: Connection, actor: Actor, *, run_id: uuid.UUID, said: RunFinish) -> RunFinished:
    """Write down how a run ended, with all that it said. Said again, the same answer comes.

    Raises:
        RunGone: the runner does not hold the run by this attempt, and did not end it.
    """
    over = (await db.execute(queries.ended_run(actor, run_id, said.attempt))).scalar_one_or_none()
    if over is not None:
        return RunFinished(state=RunState(over))
    row = await hold(db, actor, run_id, said.attempt)
    problems = list(said.problems)
    artifacts = await _artifacts(db, run_id)
    if said.reason is EndReason.done:
        problems += await put_back(db, row, said.report.put_back, artifacts)
    await _keep_words(db, run_id, said.report)
    samples = thinned([*row.samples, *(each.model_dump(mode="json") for each in said.samples)])
    values = {
        "problems": problems[:200],
        "exit_code": said.exit_code,
        "proposed": said.report.metadata,
        "previews": [each.model_dump(mode="json") for each in said.report.previews if each.path in artifacts],
        "artifact_count": len(artifacts),
        "metric_count": len(said.report.metrics),
        "finding_counts": _counted(said.report),
        "samples": samples,
        "usage": row.usage if said.usage is None else said.usage.model_dump(mode="json"),
    }
    await end_run(db, row, said.reason, said.message, **values)
    state = (await db.execute(select(run.c.state).where(run.c.id == run_id))).scalar_one()
    name = row.definition["name"]
    after: Metadata = {"reason": said.reason.value, "artifacts": len(artifacts)}
    event = Event("run.end", "run", run_id, name, row.project_id, after=after, mission_id=row.mission_id)
    await record(db, actor, event)
    return RunFinished(state=RunState(state))


async def _artifacts(db: Connection, run_id: uuid.UUID) -> dict[str, Row[Any]]:
    stmt = select(run_artifact, blob.c.size_bytes, blob.c.sha256).join_from(run_artifact, blob)
    return {row.path: row for row in await db.execute(stmt.where(run_artifact.c.run_id == run_id))}


async def _keep_words(db: Connection, run_id: uuid.UUID, report: Report) -> None:
    findings = [{"run_id": run_id, **each.model_dump(mode="json")} for each in report.findings]
    metrics = [{"run_id": run_id, **each.model_dump(mode="json")} for each in report.metrics]
    for table, rows in ((run_finding, findings), (run_metric, metrics)):
        for first in range(0, len(rows), _AT_ONCE):
            await db.execute(insert(table), rows[first : first + _AT_ONCE])


def _counted(report: Report) -> Mapping[str, int]:
    counts = {severity.value: 0 for severity in Severity}
    for each in report.findings:
        counts[each.severity.value] += 1
    return {severity: count for severity, count in counts.items() if count}


async def put_back(
    db: Connection, row: Row[Any], wanted: Sequence[PutBack], artifacts: Mapping[str, Row[Any]]
) -> list[str]:
    """Make files of artifacts of a run that is held; return, as sentences, why some could not be made.

    Nothing that is in the mission already is changed.
    """
    wanted = [each for each in wanted if each.path in artifacts]
    if not wanted:
        return []
    most = Right(row.definition["right"])
    starter = await find_person(db, row.started_by_id)
    if starter is None or most.level < Right.create.level:
        return ["It put files back, which takes an action that declares `right: CREATE`; they stay artifacts."]
    actor = replace(starter.asking("begin_uploads", request_id=None, address=None), most=most)
    try:
        await missions.lock_mission_to_fill(db, actor, row.mission_id)
        size_bytes = sum(artifacts[each.path].size_bytes for each in wanted)
        asked = Amount(len(wanted), size_bytes)
        await require_room(db, actor, project_id=row.project_id, asked=asked)
    except KleinkramError as error:
        return [f"What it put back stays among the artifacts: {error}"]
    problems, made = await _make_all(db, row, wanted, artifacts)
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
        await record_all(db, actor, events)
        await regroup(db, row.mission_id)
    return problems


async def _make_all(
    db: Connection, row: Row[Any], wanted: Sequence[PutBack], artifacts: Mapping[str, Row[Any]]
) -> tuple[list[str], dict[str, uuid.UUID]]:
    problems, made = [], {}
    for each in wanted:
        try:
            await check_path_free(db, row.mission_id, each.to)
        except KleinkramError as error:
            problems.append(f"{each.path} was not put back: {error}")
            continue
        made[each.to] = await _make(db, row, each, artifacts[each.path])
    return problems, made


async def _make(db: Connection, row: Row[Any], wanted: PutBack, artifact: Row[Any]) -> uuid.UUID:
    file_id = uuid.uuid4()
    values = {"mission_id": row.mission_id, "blob_id": artifact.blob_id, "uploaded_by_id": row.started_by_id}
    place = {"path": wanted.to, "path_key": name_key(wanted.to), "origin": "run"}
    await db.execute(insert(file).values(id=file_id, **values, **place))
    lineage = {"file_id": file_id, "made_from": wanted.made_from}
    await db.execute(update(run_artifact).where(run_artifact.c.id == artifact.id).values(**lineage))
    # As an artifact, nobody read it: as a file it may be a recording.
    unread = {"content": ContentState.pending.value, "summarised_at": None}
    await db.execute(update(blob).where(blob.c.id == artifact.blob_id).values(**unread))
    await examine_blobs(db, [artifact.blob_id])
    return file_id
