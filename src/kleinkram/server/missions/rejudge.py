"""Requests that the checks of missions are evaluated again. The job is in `server/checks/jobs.py`."""

import uuid
from collections.abc import Collection

from sqlalchemy import exists, or_, select, update

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


async def judge_project_again(db: Connection, project_id: uuid.UUID) -> None:
    """Have all missions of a project judged after this transaction; until then, their verdicts are outdated."""
    own = select(mission.c.id).where(mission.c.project_id == project_id)
    outdated = update(mission_checks).where(mission_checks.c.mission_id.in_(own))
    await db.execute(outdated.values(is_outdated=True))
    await enqueue(db, Job.judge_project, ids=[str(project_id)], priority=Priority.normal)


async def judge_again_for_run(db: Connection, run_id: uuid.UUID) -> None:
    """Have the mission of a run judged if its project names the action of the run.

    It locks the mission: see `judge_again`.
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
        .where(run.c.id == run_id)
    )
    mission_id = (await db.execute(named.with_for_update(of=mission, key_share=True))).scalar_one_or_none()
    if mission_id is not None:
        await judge_again(db, [mission_id])
