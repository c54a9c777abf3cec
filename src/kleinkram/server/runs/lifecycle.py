"""Ends of runs: cancelled, lost with their runners, or completed; then artifacts may become files of the mission."""

import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from typing import NamedTuple

from sqlalchemy import delete, func, insert, or_, select, update

from kleinkram.contract.access import Right
from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.checks import CheckStatus
from kleinkram.contract.errors import Forbidden, KleinkramError
from kleinkram.contract.files import ContentState
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.reports import MissionFile, Report, Severity
from kleinkram.contract.runs import EndReason, RunRead, RunState
from kleinkram.contract.uploads import UploadState
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor, find_person
from kleinkram.server.access.rights import require_mission
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs.service import enqueue_reading
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.jobs.rejudge import judge_again_for_run
from kleinkram.server.missions import service as missions
from kleinkram.server.quotas import Amount, require_room
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.runs import service
from kleinkram.server.runs.eligibility import is_alive
from kleinkram.server.tables import (
    blob,
    file,
    mission,
    project,
    run,
    run_artifact,
    run_check,
    run_finding,
    run_metric,
    runner,
    token,
    upload,
)
from kleinkram.server.tables.blobs import UNDER_WAY
from kleinkram.server.tables.runs import ASSIGNED

# How often a run is queued again after its runner was lost.
_MAX_REQUEUES = 2
_BATCH = 500
_REPORT_BATCH = 1000


async def cancel_run(db: Connection, actor: Actor, *, run_id: uuid.UUID, weakest: Isolation) -> RunRead:
    """Cancel a run: at once where it is queued, within seconds where a runner has it. No effect on an ended run.

    `weakest` is the setting `weakest_isolation`.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: another person launched it, and they do not have DELETE on its mission.
    """
    await db.execute(select(run.c.id).where(run.c.id == run_id).with_for_update(key_share=True))
    visible = await service.find_run(db, actor, run_id)
    where, state = visible.run.mission, visible.run.state.value
    await require_mission(db, actor, "cancel_run", where.id)
    if visible.started_by_id != actor.person_id and visible.level < Right.delete.level:
        raise Forbidden(resource_type="mission", operation="cancel another person's run", needs=Right.delete.value)
    if state == RunState.queued.value:
        await end_run(db, run_id, EndReason.cancelled, f"Cancelled by {actor.name} before it started.")
    elif state in ASSIGNED and visible.run.cancel_requested_at is None:
        await db.execute(update(run).where(run.c.id == run_id).values(cancel_requested_at=func.now()))
    else:
        return await service.get_run(db, actor, run_id, weakest=weakest)
    event = Event("run.cancel", "run", run_id, visible.run.action.name, where.project.id, mission_id=where.id)
    await audit(db, actor, event)
    return await service.get_run(db, actor, run_id, weakest=weakest)


async def end_run(db: Connection, run_id: uuid.UUID, reason: EndReason, message: str, **values: object) -> RunState:
    """Record the end of a run, and revoke its token and open uploads; the caller has locked it. Return its state."""
    state = {EndReason.done: RunState.done, EndReason.cancelled: RunState.cancelled}.get(reason, RunState.failed)
    values |= {"state": state.value, "reason": reason.value, "message": message, "lease_ends_at": None}
    await _discard_attempt(db, run_id, keep_results=reason is not EndReason.lost)
    claimed_s = await _update(db, run_id, ended_at=func.now(), **values)
    metrics.RUNS_ENDED.labels(state.value, reason.value).inc()
    if claimed_s is not None:
        metrics.RUN_SECONDS.labels(state.value).observe(float(claimed_s))
    return state


async def _update(db: Connection, run_id: uuid.UUID, **values: object) -> Decimal | None:
    """Change a run; return the seconds since a runner claimed it, if one did."""
    claimed_s = func.extract("epoch", func.now() - run.c.claimed_at)
    stmt = update(run).where(run.c.id == run_id).values(**values).returning(run.c.mission_id, claimed_s)
    mission_id: uuid.UUID
    seconds: Decimal | None
    mission_id, seconds = (await db.execute(stmt)).one()
    await publish(db, [ChangeEvent("run", ChangeKind.changed, run_id, mission_id=mission_id)])
    await judge_again_for_run(db, run_id)
    return seconds


async def _discard_attempt(db: Connection, run_id: uuid.UUID, *, keep_results: bool) -> None:
    """Revoke the token of an attempt, abort its uploads, and delete its artifacts unless `keep_results`."""
    await db.execute(update(token).where(token.c.run_id == run_id).values(revoked_at=func.now()))
    open_uploads = (upload.c.run_id == run_id) & upload.c.state.in_(UNDER_WAY)
    await db.execute(update(upload).where(open_uploads).values(state=UploadState.aborted.value))
    if not keep_results:
        await db.execute(delete(run_artifact).where(run_artifact.c.run_id == run_id))


async def requeue_lost_runs(db: Connection) -> int:
    """Queue runs again whose lease has expired, or end them; return their number.

    A cancelled run of a runner that is not alive ends before its lease does.
    """
    alive = select(runner.c.id).where(runner.c.id == run.c.runner_id, is_alive()).exists()
    is_due = (run.c.lease_ends_at < func.now()) | (run.c.cancel_requested_at.is_not(None) & ~alive)
    expired = run.c.state.in_(ASSIGNED) & is_due
    stmt = select(run.c.id, run.c.cancel_requested_at, run.c.lost_count).where(expired)
    rows = (await db.execute(stmt.order_by(run.c.id).limit(_BATCH).with_for_update(skip_locked=True))).all()
    unassigned = dict.fromkeys(
        ("lease_ends_at", "runner_id", "isolation", "progress", "placement", "usage", "claimed_at", "started_at")
    )
    for row in rows:
        if row.cancel_requested_at is not None:
            await end_run(db, row.id, EndReason.cancelled, "Cancelled; its runner was lost.")
        elif row.lost_count >= _MAX_REQUEUES:
            times = f"{_MAX_REQUEUES + 1} times"
            message = f"The runner that had it was lost, {times}. Check the logs of the runners, then retry it."
            await end_run(db, row.id, EndReason.lost, message)
        else:
            await _discard_attempt(db, row.id, keep_results=False)
            queued = {"state": RunState.queued.value, "samples": [], "lost_count": row.lost_count + 1}
            await _update(db, row.id, **queued, **unassigned)
    return len(rows)


async def cancel_orphans(db: Connection) -> None:
    """Cancel queued runs of missions in the trash."""
    deleted = or_(mission.c.deleted_at.is_not(None), project.c.deleted_at.is_not(None))
    stmt = select(run.c.id).join_from(run, mission, mission.c.id == run.c.mission_id).join(project)
    queued = stmt.where(run.c.state == RunState.queued.value, deleted).limit(_BATCH)
    for run_id in (await db.execute(queued.with_for_update(of=run, skip_locked=True))).scalars().all():
        await end_run(db, run_id, EndReason.cancelled, "Its mission was deleted before it started.")


async def store_report(db: Connection, run_id: uuid.UUID, report: Report) -> dict[str, object]:
    """Store the checks, findings and metrics of a run; return the columns of the run that follow from its report."""
    for table, entries in ((run_check, report.checks), (run_finding, report.findings), (run_metric, report.metrics)):
        rows = [{"run_id": run_id, **entry.model_dump(mode="json")} for entry in entries]
        for first in range(0, len(rows), _REPORT_BATCH):
            await db.execute(insert(table), rows[first : first + _REPORT_BATCH])
    statuses = Counter(entry.status.value for entry in report.checks)
    severities = Counter(entry.severity.value for entry in report.findings)
    return {
        "proposed": report.metadata,
        "metric_count": len(report.metrics),
        "check_counts": {status.value: statuses[status.value] for status in CheckStatus if statuses[status.value]},
        "finding_counts": {level.value: severities[level.value] for level in Severity if severities[level.value]},
    }


class RunArtifact(NamedTuple):
    """An artifact of a run, with its stored bytes."""

    id: uuid.UUID
    path: str
    blob_id: uuid.UUID
    size_bytes: int


class EndedRun(NamedTuple):
    """A run whose end is being recorded."""

    id: uuid.UUID
    mission_id: uuid.UUID
    project_id: uuid.UUID
    started_by_id: uuid.UUID
    definition: ActionDefinition


async def create_mission_files(
    db: Connection, ended: EndedRun, selected: Sequence[MissionFile], artifacts: Mapping[str, RunArtifact]
) -> list[str]:
    """Create files of the mission from artifacts of a run; return sentences about those that could not be created.

    Existing files are never changed. The actor is the person who launched the run, with their current rights.
    """
    selected = [entry for entry in selected if entry.path in artifacts]
    if not selected:
        return []
    most = ended.definition.right
    starter = await find_person(db, ended.started_by_id)
    if starter is None or most.level < Right.create.level:
        return ["Files of the mission require an action with `right: CREATE`; they stay artifacts."]
    actor = replace(starter.for_request("begin_uploads", request_id=None, address=None), max_right=most)
    try:
        await missions.lock_mission_to_fill(db, actor, ended.mission_id)
        size_bytes = sum(artifacts[entry.path].size_bytes for entry in selected)
        await require_room(db, actor, project_id=ended.project_id, requested=Amount(len(selected), size_bytes))
    except KleinkramError as error:
        return [f"No file of the mission was created; the artifacts stay: {error}"]
    problems: list[str] = []
    events: list[Event] = []
    after: Metadata = {"run_id": str(ended.id), "action": ended.definition.name}
    for entry in selected:
        try:
            await check_path_free(db, ended.mission_id, entry.to)
        except KleinkramError as error:
            problems.append(f"{entry.path} did not become a file of the mission: {error}")
            continue
        file_id = await _create_file(db, ended, entry, artifacts[entry.path])
        events.append(
            Event("file.create", "file", file_id, entry.to, ended.project_id, after=after, mission_id=ended.mission_id)
        )
    if events:
        await audit(db, actor, *events)
        await derive_again(db, ended.mission_id)
    return problems


async def _create_file(db: Connection, ended: EndedRun, selected: MissionFile, artifact: RunArtifact) -> uuid.UUID:
    file_id = uuid.uuid4()
    values = {"mission_id": ended.mission_id, "blob_id": artifact.blob_id, "uploaded_by_id": ended.started_by_id}
    path = {"path": selected.to, "path_key": name_key(selected.to), "origin": "run"}
    await db.execute(insert(file).values(id=file_id, **values, **path))
    lineage = {"file_id": file_id, "derived_from": selected.derived_from}
    await db.execute(update(run_artifact).where(run_artifact.c.id == artifact.id).values(**lineage))
    # The content of artifacts is not read; as a file it may be a recording.
    unread = {"content": ContentState.pending.value, "summarised_at": None}
    await db.execute(update(blob).where(blob.c.id == artifact.blob_id).values(**unread))
    await enqueue_reading(db, [artifact.blob_id])
    return file_id
