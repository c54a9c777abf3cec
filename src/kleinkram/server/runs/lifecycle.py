"""How runs come to an end other than by their own: cancelled, or lost with their runners too often."""

import datetime
import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row, delete, func, or_, select, update

from kleinkram.contract.errors import Forbidden
from kleinkram.contract.events import ChangeKind
from kleinkram.contract.rights import Right
from kleinkram.contract.runners import LEASE_S
from kleinkram.contract.runs import EndReason, RunRead, RunState
from kleinkram.contract.uploads import UploadState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission
from kleinkram.server.audit.service import Event, record
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection
from kleinkram.server.runs import service
from kleinkram.server.tables import mission, project, run, run_artifact, runner, token, upload
from kleinkram.server.tables.run import HELD
from kleinkram.server.tables.upload import UNDER_WAY

# So often a run is given to another runner after its own was lost.
MOST_LOST = 2
_BATCH = 500
_SILENT = datetime.timedelta(seconds=LEASE_S)


async def cancel_run(db: Connection, actor: Actor, *, run_id: uuid.UUID) -> RunRead:
    """Cancel a run: at once where it is queued, within seconds where a runner has it. One that is over stays so.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: it is another's, and they do not hold DELETE on its mission.
    """
    await service.lock_run(db, run_id)
    row = await service.find_run_row(db, actor, run_id)
    await require_mission(db, actor, "cancel_run", row.mission_id)
    if row.started_by_id != actor.person_id and row.level < Right.delete.level:
        raise Forbidden(noun="mission", operation="cancel another's run", needs=Right.delete.value)
    if row.state == RunState.queued.value:
        await end_run(db, row, EndReason.cancelled, f"Cancelled by {actor.name} before it began.")
    elif row.state in HELD and row.cancel_requested_at is None:
        await db.execute(update(run).where(run.c.id == run_id).values(cancel_requested_at=func.now()))
    else:
        return await service.get_run(db, actor, run_id)
    event = Event("run.cancel", "run", run_id, row.action_name, row.project_id, mission_id=row.mission_id)
    await record(db, actor, event)
    return await service.get_run(db, actor, run_id)


async def end_run(db: Connection, row: Row[Any], reason: EndReason, message: str, **values: object) -> None:
    """Write down that a run is over, and end all that was good only while it lasted; the caller holds the run."""
    state = {EndReason.done: RunState.done, EndReason.cancelled: RunState.cancelled}.get(reason, RunState.failed)
    said = {"state": state.value, "reason": reason.value, "message": message, "lease_ends_at": None}
    ended = update(run).where(run.c.id == row.id).values(ended_at=func.now(), **said, **values)
    await db.execute(ended)
    await discard_attempt(db, [row.id], keep_results=reason is not EndReason.lost)
    await publish(db, [ChangeEvent("run", ChangeKind.changed, row.id, mission_id=row.mission_id)])


async def discard_attempt(db: Connection, run_ids: Sequence[uuid.UUID], *, keep_results: bool) -> None:
    """End what an attempt at a run could do and was doing: its token and uploads; and what it left, unless kept."""
    await db.execute(update(token).where(token.c.run_id.in_(run_ids)).values(revoked_at=func.now()))
    open_still = upload.c.run_id.in_(run_ids) & upload.c.state.in_(UNDER_WAY)
    await db.execute(update(upload).where(open_still).values(state=UploadState.aborted.value))
    if not keep_results:
        await db.execute(delete(run_artifact).where(run_artifact.c.run_id.in_(run_ids)))


async def requeue_lost_runs(db: Connection) -> int:
    """Give runs whose lease ran out to the queue again, or end them; return how many there were.

    Who wants one cancelled whose runner is silent need not wait for a long lease to run out.
    """
    heard = (runner.c.id == run.c.runner_id) & (runner.c.last_seen_at > func.now() - _SILENT)
    silent = run.c.cancel_requested_at.is_not(None) & ~select(runner.c.id).where(heard).exists()
    lapsed = run.c.state.in_(HELD) & ((run.c.lease_ends_at < func.now()) | silent)
    stmt = select(run).where(lapsed).order_by(run.c.id).limit(_BATCH).with_for_update(skip_locked=True)
    rows = (await db.execute(stmt)).all()
    for row in rows:
        if row.cancel_requested_at is not None:
            await end_run(db, row, EndReason.cancelled, "Cancelled; its runner was lost meanwhile.")
        elif row.lost_count >= MOST_LOST:
            times = f"{MOST_LOST + 1} times"
            message = f"The runner that had it was lost, {times}. Look at the runners' logs, then try it again."
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
    gone = or_(mission.c.deleted_at.is_not(None), project.c.deleted_at.is_not(None))
    stmt = (
        select(run)
        .join(mission, mission.c.id == run.c.mission_id)
        .join(project)
        .where(run.c.state == RunState.queued.value, gone)
    )
    for row in (await db.execute(stmt.limit(_BATCH).with_for_update(of=run, skip_locked=True))).all():
        await end_run(db, row, EndReason.cancelled, "Its mission was deleted before it began.")
