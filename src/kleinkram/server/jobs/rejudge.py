"""Requests that the checks of missions are evaluated again. The job is in `server/checks/jobs.py`."""

import uuid
from collections.abc import Collection

from sqlalchemy import exists, func, or_, select, update

from kleinkram.server.db import Connection, among
from kleinkram.server.jobs.queue import Job, Priority, enqueue, with_waiting_job
from kleinkram.server.tables import (
    action_version,
    check_report,
    mission,
    mission_checks,
    project,
    project_action,
    run,
)

# The first half of the keys of the advisory locks, of which each project has one.
_LOCK_CLASS = 0x6B6C4A47

# What a mission can be judged by, or was.
_IS_JUDGED = or_(
    project.c.checks_number > 0,
    exists().where(mission_checks.c.mission_id == mission.c.id),
    exists().where(check_report.c.mission_id == mission.c.id),
    exists().where(project_action.c.project_id == mission.c.project_id),
)


async def judge_again(db: Connection, mission_ids: Collection[uuid.UUID]) -> None:
    """Have missions judged after this transaction; until then, their verdicts are outdated.

    The caller's transaction must hold the locks of the missions: then a queued job, which begins by acquiring them,
    cannot miss this change. Missions without anything to be judged by are left out.
    """
    outdated = update(mission_checks).where(among(mission_checks.c.mission_id, mission_ids))
    await db.execute(outdated.values(is_outdated=True))
    judged = select(mission.c.id).join(project, project.c.id == mission.c.project_id)
    judged = judged.where(among(mission.c.id, mission_ids), _IS_JUDGED)
    refs = [str(mission_id) for mission_id in (await db.execute(judged)).scalars()]
    if refs:
        waiting = await with_waiting_job(db, Job.judge_mission, refs)
        left = [ref for ref in refs if ref not in waiting]
        await enqueue(db, Job.judge_mission, ids=left, priority=Priority.normal)


async def judge_projects_again(db: Connection, project_ids: Collection[uuid.UUID]) -> None:
    """Have all missions of projects judged after this transaction; until then, their verdicts are outdated.

    For changes of what projects name. Until this transaction ends, none of their missions is judged, so that no verdict
    that misses the change can be stored after it.
    """
    for key in _lock_keys(project_ids):
        await db.execute(select(func.pg_advisory_xact_lock(_LOCK_CLASS, key)))
    own = select(mission.c.id).where(among(mission.c.project_id, project_ids))
    outdated = update(mission_checks).where(mission_checks.c.mission_id.in_(own))
    await db.execute(outdated.values(is_outdated=True))
    await enqueue(db, Job.judge_project, ids=[str(one) for one in project_ids], priority=Priority.normal)


async def lock_what_projects_name(db: Connection, mission_ids: Collection[uuid.UUID]) -> None:
    """Delay `judge_projects_again` for the projects of missions until this transaction ends.

    The caller's transaction must hold the locks of the missions.
    """
    stmt = select(mission.c.project_id).where(among(mission.c.id, mission_ids)).distinct()
    for key in _lock_keys((await db.execute(stmt)).scalars().all()):
        await db.execute(select(func.pg_advisory_xact_lock_shared(_LOCK_CLASS, key)))


def _lock_keys(project_ids: Collection[uuid.UUID]) -> list[int]:
    """Return keys in one order, so that two transactions cannot deadlock."""
    return sorted({int.from_bytes(project_id.bytes[:4], "big", signed=True) for project_id in project_ids})


async def judge_again_for_runs(db: Connection, run_ids: Collection[uuid.UUID]) -> None:
    """Have the missions of runs judged whose project names the action of the run.

    It locks the missions: see `judge_again`.
    """
    named = (
        select(mission.c.id)
        .join(run, run.c.mission_id == mission.c.id)
        .join(action_version, action_version.c.id == run.c.version_id)
        .join(
            project_action,
            (project_action.c.action_id == action_version.c.action_id)
            & (project_action.c.project_id == mission.c.project_id),
        )
        .where(among(run.c.id, run_ids))
        .order_by(mission.c.id)
    )
    mission_ids = (await db.execute(named.with_for_update(of=mission, key_share=True))).scalars().all()
    if mission_ids:
        await judge_again(db, {*mission_ids})
