"""The ends of runs, as their runner reports them: with the report, the small log and the files of the mission.

Several ends cost little more than one: a cluster ends hundreds of short jobs a minute.
"""

import uuid
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sqlalchemy import select

from kleinkram.contract.checks import Verdict
from kleinkram.contract.errors import RunGone
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.reports import verdict_of_report
from kleinkram.contract.runners import RunEnd, RunEndsRecorded, RunFinish, RunFinished
from kleinkram.contract.runs import EndReason, RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among, insert_rows
from kleinkram.server.runners.assigned_runs import (
    AssignedRun,
    find_definitions,
    is_of_runner,
    lock_assigned_runs,
    pin_images,
    require_own,
    thinned,
)
from kleinkram.server.runs.lifecycle import (
    EndedRun,
    RunArtifact,
    RunEnding,
    create_mission_files,
    end_runs,
    report_columns,
    store_reports,
)
from kleinkram.server.tables import blob, run, run_artifact, run_log

_MAX_PROBLEMS = 200


async def finish_run(context: AppContext, actor: Actor, *, run_id: uuid.UUID, finish: RunFinish) -> RunFinished:
    """Record the end of a run, with its report. Idempotent.

    Raises:
        RunGone: the runner does not have the run by this attempt, and did not end it.
    """
    async with context.database.begin() as db:
        states = await _record(db, actor, {run_id: finish})
    if run_id not in states:
        raise RunGone(run_id=str(run_id))
    return RunFinished(state=states[run_id])


async def finish_runs(
    context: AppContext, actor: Actor, *, runner_id: uuid.UUID, reported: Sequence[RunEnd]
) -> RunEndsRecorded:
    """Record the ends of several runs, as `finish_run` does, and return their states; null for RunGone.

    Raises:
        NotFound: the token is not this runner's.
    """
    require_own(actor, runner_id)
    finishes = {end.run_id: end.finish for end in reported}
    # Those that create files lock their missions: each in a transaction of its own, so that two cannot deadlock.
    alone = {run_id: finish for run_id, finish in finishes.items() if finish.report.mission_files}
    together = {run_id: finish for run_id, finish in finishes.items() if run_id not in alone}
    states: dict[uuid.UUID, RunState] = {}
    for group in (together, *({run_id: finish} for run_id, finish in alone.items())):
        if group:
            async with context.database.begin() as db:
                states |= await _record(db, actor, group)
    return RunEndsRecorded(states=[states.get(end.run_id) for end in reported])


class _Ended(NamedTuple):
    """A run whose end is recorded, with what its runner reports."""

    row: AssignedRun
    finish: RunFinish
    artifacts: Mapping[str, RunArtifact]

    @property
    def verdict(self) -> Verdict | None:
        """The verdict of its report, if it is done."""
        return verdict_of_report(self.finish.report) if self.finish.reason is EndReason.done else None


async def _record(db: Connection, actor: Actor, finishes: Mapping[uuid.UUID, RunFinish]) -> dict[uuid.UUID, RunState]:
    """Record the ends of runs; return the states of those that the runner has, or ended before, by these attempts."""
    rows = await lock_assigned_runs(db, actor, {run_id: finish.attempt for run_id, finish in finishes.items()})
    artifacts = await _artifacts_of(db, [row.id for row in rows])
    ended = [_Ended(row, finishes[row.id], artifacts[row.id]) for row in rows]
    states = await _earlier_states(
        db, actor, {one: finishes[one] for one in finishes.keys() - {row.id for row in rows}}
    )
    if not ended:
        return states
    unpinned = [one for one in ended if one.finish.image_digest is not None and one.row.image_digest is None]
    await pin_images(db, {one.row.version_id: one.finish.image_digest or "" for one in unpinned})
    await store_reports(db, {one.row.id: one.finish.report for one in ended})
    await _store_logs(db, ended)
    samples = await _all_samples(db, ended)
    endings = [
        RunEnding(
            one.row.id, one.finish.reason, one.finish.message, await _values(db, one) | samples.get(one.row.id, {})
        )
        for one in ended
    ]
    await end_runs(db, endings)
    await audit(db, actor, *map(_event, ended))
    return states | {ending.run_id: ending.state for ending in endings}


async def _earlier_states(
    db: Connection, actor: Actor, finishes: Mapping[uuid.UUID, RunFinish]
) -> dict[uuid.UUID, RunState]:
    """Return the states of runs that this runner ended before: the answer to it was lost."""
    if not finishes:
        return {}
    stmt = select(run.c.id, run.c.attempt, run.c.state).where(among(run.c.id, finishes), is_of_runner(actor))
    rows = await db.execute(stmt.where(run.c.ended_at.is_not(None)))
    return {row.id: RunState(row.state) for row in rows if row.attempt == finishes[row.id].attempt}


async def _artifacts_of(db: Connection, run_ids: Sequence[uuid.UUID]) -> defaultdict[uuid.UUID, dict[str, RunArtifact]]:
    columns = (run_artifact.c.id, run_artifact.c.path, run_artifact.c.blob_id, blob.c.size_bytes, run_artifact.c.run_id)
    stmt = select(*columns).join_from(run_artifact, blob).where(among(run_artifact.c.run_id, run_ids))
    artifacts: defaultdict[uuid.UUID, dict[str, RunArtifact]] = defaultdict(dict)
    for *entry, run_id in await db.execute(stmt):
        artifact = RunArtifact._make(entry)
        artifacts[run_id][artifact.path] = artifact
    return artifacts


async def _store_logs(db: Connection, ended: Sequence[_Ended]) -> None:
    logs = [{"run_id": one.row.id, "content": one.finish.log} for one in ended if one.finish.log]
    if logs:
        await db.execute(insert_rows(run_log, logs))


async def _all_samples(db: Connection, ended: Sequence[_Ended]) -> dict[uuid.UUID, dict[str, object]]:
    """Return the samples of runs that report further ones."""
    new = {one.row.id: one.finish.samples for one in ended if one.finish.samples}
    if not new:
        return {}
    stored = await db.execute(select(run.c.id, run.c.samples).where(among(run.c.id, new)))
    return {run_id: {"samples": thinned(samples, new[run_id])} for run_id, samples in stored}


async def _values(db: Connection, ended: _Ended) -> dict[str, object]:
    """Return further columns of an ended run; create the files of the mission that it selected."""
    row, finish = ended.row, ended.finish
    problems = list(finish.problems)
    if finish.reason is EndReason.done and finish.report.mission_files:
        definition = (await find_definitions(db, [row]))[row.version_id]
        creator = EndedRun(row.id, row.mission_id, row.project_id, row.started_by_id, definition)
        problems += await create_mission_files(db, creator, finish.report.mission_files, ended.artifacts)
    shown = [entry for entry in finish.report.previews if entry.path in ended.artifacts]
    values: dict[str, object] = report_columns(finish.report) | {
        "problems": problems[:_MAX_PROBLEMS],
        "exit_code": finish.exit_code,
        "previews": [entry.model_dump(mode="json") for entry in shown],
        "artifact_count": len(ended.artifacts),
        "verdict": ended.verdict and ended.verdict.value,
        "image_digest": finish.image_digest,
    }
    for name, reported in (("placement", finish.placement), ("usage", finish.usage)):
        if reported is not None:
            values[name] = reported.model_dump(mode="json")
    return values


def _event(ended: _Ended) -> Event:
    row = ended.row
    after: Metadata = {"reason": ended.finish.reason.value, "artifacts": len(ended.artifacts)}
    if ended.verdict is not None:
        after["verdict"] = ended.verdict.value
    return Event("run.end", "run", row.id, row.action_name, row.project_id, after=after, mission_id=row.mission_id)
