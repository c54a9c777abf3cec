"""Ends of runs: cancelled, lost with their runners, or completed; then artifacts may become files of the mission."""

import uuid
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from pydantic_core import to_json
from sqlalchemy import delete, func, insert, or_, select, text, update

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
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor, find_person
from kleinkram.server.access.rights import require_mission
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs.service import enqueue_reading
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, among
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.jobs.rejudge import judge_again_for_runs
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
)
from kleinkram.server.tables.runs import ASSIGNED

# How often a run is queued again after its runner was lost.
_MAX_REQUEUES = 2
_BATCH = 500
_REPORT_BATCH = 1000
_END = text("""
UPDATE run SET
  state = ended.state, reason = ended.reason, message = ended.message, lease_ends_at = NULL, ended_at = now(),
  exit_code = coalesce(ended.exit_code, run.exit_code),
  image_digest = coalesce(run.image_digest, ended.image_digest),
  verdict = coalesce(ended.verdict, run.verdict),
  artifact_count = coalesce(ended.artifact_count, run.artifact_count),
  metric_count = coalesce(ended.metric_count, run.metric_count),
  check_counts = coalesce(ended.check_counts, run.check_counts),
  finding_counts = coalesce(ended.finding_counts, run.finding_counts),
  problems = coalesce(ended.problems, run.problems),
  proposed = coalesce(ended.proposed, run.proposed),
  previews = coalesce(ended.previews, run.previews),
  placement = coalesce(ended.placement, run.placement),
  usage = coalesce(ended.usage, run.usage),
  samples = coalesce(ended.samples, run.samples)
FROM jsonb_to_recordset(CAST(:ended AS jsonb)) AS ended(
  id uuid, state text, reason text, message text, exit_code integer, image_digest text, verdict text,
  artifact_count integer, metric_count integer, check_counts jsonb, finding_counts jsonb, problems jsonb,
  proposed jsonb, previews jsonb, placement jsonb, usage jsonb, samples jsonb
)
WHERE run.id = ended.id
RETURNING run.id, run.mission_id, run.state, run.reason, extract(epoch FROM now() - run.claimed_at) AS claimed_s
""")
_DISCARD = text("""
WITH revoked AS (
  UPDATE token SET revoked_at = now() WHERE run_id = ANY (CAST(:run_ids AS uuid[])) AND revoked_at IS NULL
)
UPDATE upload SET state = 'aborted'
WHERE run_id = ANY (CAST(:run_ids AS uuid[])) AND state IN ('open', 'completing')
""")


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


@dataclass(frozen=True)
class RunEnding:
    """How a run ended. `values`: further columns of `_END`, as JSON has them."""

    run_id: uuid.UUID
    reason: EndReason
    message: str
    values: Mapping[str, object] = field(default_factory=dict)

    @property
    def state(self) -> RunState:
        """The final state of the run."""
        return {EndReason.done: RunState.done, EndReason.cancelled: RunState.cancelled}.get(
            self.reason, RunState.failed
        )


async def end_runs(db: Connection, endings: Sequence[RunEnding]) -> None:
    """Record the ends of runs, and revoke their tokens and open uploads.

    The caller has locked them, and publishes the changes, as `audit` does.
    """
    lost = {ending.run_id for ending in endings if ending.reason is EndReason.lost}
    await _discard_attempts(db, [ending.run_id for ending in endings], without_results=lost)
    ended = [
        {
            **ending.values,
            "id": ending.run_id,
            "state": ending.state.value,
            "reason": ending.reason.value,
            "message": ending.message,
        }
        for ending in endings
    ]
    rows = (await db.execute(_END, {"ended": to_json(ended).decode()})).all()
    for row in rows:
        metrics.RUNS_ENDED.labels(row.state, row.reason).inc()
        if row.claimed_s is not None:
            metrics.RUN_SECONDS.labels(row.state).observe(float(row.claimed_s))
    await judge_again_for_runs(db, [row.id for row in rows])


async def end_run(db: Connection, run_id: uuid.UUID, reason: EndReason, message: str) -> None:
    """Record and publish the end of one run, as `end_runs` does."""
    await end_runs(db, [RunEnding(run_id, reason, message)])
    mission_id = (await db.execute(select(run.c.mission_id).where(run.c.id == run_id))).scalar_one()
    await publish(db, [ChangeEvent("run", ChangeKind.changed, run_id, mission_id=mission_id)])


async def _discard_attempts(
    db: Connection, run_ids: Collection[uuid.UUID], *, without_results: Collection[uuid.UUID]
) -> None:
    """Revoke the tokens of attempts, abort their uploads, and delete their artifacts if they are `without_results`."""
    await db.execute(_DISCARD, {"run_ids": [*run_ids]})
    if without_results:
        await db.execute(delete(run_artifact).where(among(run_artifact.c.run_id, without_results)))


async def requeue_lost_runs(db: Connection) -> int:
    """Queue runs again whose lease has expired, or end them; return their number.

    A cancelled run of a runner that is not alive ends before its lease does.
    """
    alive = select(runner.c.id).where(runner.c.id == run.c.runner_id, is_alive()).exists()
    is_due = (run.c.lease_ends_at < func.now()) | (run.c.cancel_requested_at.is_not(None) & ~alive)
    expired = run.c.state.in_(ASSIGNED) & is_due
    stmt = select(run.c.id, run.c.mission_id, run.c.cancel_requested_at, run.c.lost_count).where(expired)
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
            await _discard_attempts(db, [row.id], without_results=[row.id])
            queued = {"state": RunState.queued.value, "samples": [], "lost_count": row.lost_count + 1}
            await db.execute(update(run).where(run.c.id == row.id).values(**queued, **unassigned))
            await publish(db, [ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id)])
            await judge_again_for_runs(db, [row.id])
    return len(rows)


async def cancel_orphans(db: Connection) -> None:
    """Cancel queued runs of missions in the trash."""
    deleted = or_(mission.c.deleted_at.is_not(None), project.c.deleted_at.is_not(None))
    stmt = select(run.c.id).join_from(run, mission, mission.c.id == run.c.mission_id).join(project)
    queued = stmt.where(run.c.state == RunState.queued.value, deleted).limit(_BATCH)
    for run_id in (await db.execute(queued.with_for_update(of=run, skip_locked=True))).scalars().all():
        await end_run(db, run_id, EndReason.cancelled, "Its mission was deleted before it started.")


async def store_reports(db: Connection, reports: Mapping[uuid.UUID, Report]) -> None:
    """Store the checks, findings and metrics of runs."""
    for table, name in ((run_check, "checks"), (run_finding, "findings"), (run_metric, "metrics")):
        rows = [
            {"run_id": run_id, **entry.model_dump(mode="json")}
            for run_id, report in reports.items()
            for entry in getattr(report, name)
        ]
        for first in range(0, len(rows), _REPORT_BATCH):
            await db.execute(insert(table), rows[first : first + _REPORT_BATCH])


def report_columns(report: Report) -> dict[str, object]:
    """Return the columns of a run that follow from its report."""
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
