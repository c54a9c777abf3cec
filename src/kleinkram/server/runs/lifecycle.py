"""Ends of runs: cancelled, lost with their runners, or completed."""

import datetime
import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row, delete, func, or_, select, update

from kleinkram.contract.access import Right
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.errors import Forbidden
from kleinkram.contract.runners import LEASE_S
from kleinkram.contract.runs import EndReason, RunRead, RunState
from kleinkram.contract.uploads import UploadState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection
from kleinkram.server.runs import service
from kleinkram.server.tables import mission, project, run, run_artifact, runner, token, upload
from kleinkram.server.tables.blobs import UNDER_WAY
from kleinkram.server.tables.runs import ASSIGNED

# How often a run is queued again after its runner was lost.
MOST_LOST = 2
_BATCH = 500
_SILENT = datetime.timedelta(seconds=LEASE_S)


async def cancel_run(db: Connection, actor: Actor, *, run_id: uuid.UUID) -> RunRead:
    """Cancel a run: at once where it is queued, within seconds where a runner has it. No effect on an ended run.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: another person launched it, and they do not have DELETE on its mission.
    """
    await service.lock_run(db, run_id)
    row = await service.find_run_row(db, actor, run_id)
    await require_mission(db, actor, "cancel_run", row.mission_id)
    if row.started_by_id != actor.person_id and row.level < Right.delete.level:
        raise Forbidden(noun="mission", operation="cancel another person's run", needs=Right.delete.value)
    if row.state == RunState.queued.value:
        await end_run(db, row, EndReason.cancelled, f"Cancelled by {actor.name} before it started.")
    elif row.state in ASSIGNED and row.cancel_requested_at is None:
        await db.execute(update(run).where(run.c.id == run_id).values(cancel_requested_at=func.now()))
    else:
        return await service.get_run(db, actor, run_id)
    event = Event("run.cancel", "run", run_id, row.action_name, row.project_id, mission_id=row.mission_id)
    await audit(db, actor, event)
    return await service.get_run(db, actor, run_id)


async def end_run(db: Connection, row: Row[Any], reason: EndReason, message: str, **values: object) -> None:
    """Record the end of a run, and revoke its token and open uploads; the caller has locked it."""
    state = {EndReason.done: RunState.done, EndReason.cancelled: RunState.cancelled}.get(reason, RunState.failed)
    values_of_end = {"state": state.value, "reason": reason.value, "message": message, "lease_ends_at": None}
    ended = update(run).where(run.c.id == row.id).values(ended_at=func.now(), **values_of_end, **values)
    await db.execute(ended)
    await discard_attempt(db, [row.id], keep_results=reason is not EndReason.lost)
    await publish(db, [ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id)])


async def discard_attempt(db: Connection, run_ids: Sequence[uuid.UUID], *, keep_results: bool) -> None:
    """Revoke the token of an attempt, abort its uploads, and delete its artifacts unless `keep_results`."""
    await db.execute(update(token).where(token.c.run_id.in_(run_ids)).values(revoked_at=func.now()))
    open_still = upload.c.run_id.in_(run_ids) & upload.c.state.in_(UNDER_WAY)
    await db.execute(update(upload).where(open_still).values(state=UploadState.aborted.value))
    if not keep_results:
        await db.execute(delete(run_artifact).where(run_artifact.c.run_id.in_(run_ids)))


async def requeue_lost_runs(db: Connection) -> int:
    """Queue runs again whose lease has expired, or end them; return their number.

    A cancelled run of a runner that is not alive ends before its lease does.
    """
    seen = (runner.c.id == run.c.runner_id) & (runner.c.last_seen_at > func.now() - _SILENT)
    silent = run.c.cancel_requested_at.is_not(None) & ~select(runner.c.id).where(seen).exists()
    expired = run.c.state.in_(ASSIGNED) & ((run.c.lease_ends_at < func.now()) | silent)
    stmt = select(run).where(expired).order_by(run.c.id).limit(_BATCH).with_for_update(skip_locked=True)
    rows = (await db.execute(stmt)).all()
    for row in rows:
        if row.cancel_requested_at is not None:
            await end_run(db, row, EndReason.cancelled, "Cancelled; its runner was lost meanwhile.")
        elif row.lost_count >= MOST_LOST:
            times = f"{MOST_LOST + 1} times"
            message = f"The runner that had it was lost, {times}. Check the logs of the runners, then retry it."
            await end_run(db, row, EndReason.lost, message)
        else:
            await _requeue(db, row)
    return len(rows)


async def _requeue(db: Connection, row: Row[Any]) -> None:
    fresh = {"state": RunState.queued.value, "lease_ends_at": None, "runner_id": None, "progress": None, "usage": None}
    again = {**fresh, "claimed_at": None, "started_at": None, "samples": [], "lost_count": row.lost_count + 1}
    await db.execute(update(run).where(run.c.id == row.id).values(**again))
    await discard_attempt(db, [row.id], keep_results=False)
    await publish(db, [ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id)])


async def cancel_orphans(db: Connection) -> None:
    """Cancel queued runs of missions in the trash."""
    deleted = or_(mission.c.deleted_at.is_not(None), project.c.deleted_at.is_not(None))
    stmt = (
        select(run)
        .join(mission, mission.c.id == run.c.mission_id)
        .join(project)
        .where(run.c.state == RunState.queued.value, deleted)
    )
    for row in (await db.execute(stmt.limit(_BATCH).with_for_update(of=run, skip_locked=True))).all():
        await end_run(db, row, EndReason.cancelled, "Its mission was deleted before it started.")
