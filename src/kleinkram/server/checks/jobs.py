"""Jobs that judge missions: one, or all of a project whose verdicts are outdated."""

import uuid

from procrastinate import JobContext
from sqlalchemy import Text, cast

from kleinkram.server.checks import queries
from kleinkram.server.checks.judge import judge_missions
from kleinkram.server.db import Connection
from kleinkram.server.jobs.execution import RETRY_STRATEGY, app_context
from kleinkram.server.jobs.queue import Job, Priority, enqueue, has_job, queue
from kleinkram.server.tables import mission

# Missions are locked while they are judged: usually for 100 ms. Where rules or reports are long, a batch ends early.
_BATCH, _BATCH_S = 25, 1


@queue.task(name=Job.judge_mission.value, pass_context=True, retry=RETRY_STRATEGY)
async def judge_mission(job_context: JobContext, ref: str) -> None:
    """Judge one mission."""
    async with app_context(job_context).database.begin() as db:
        await judge_missions(db, [uuid.UUID(ref)])


@queue.task(name=Job.judge_project.value, pass_context=True, retry=RETRY_STRATEGY)
async def judge_project(job_context: JobContext, ref: str) -> None:
    """Judge all missions of a project whose verdicts are outdated. What an earlier attempt did is not done again."""
    database, after = app_context(job_context).database, None
    while True:
        async with database.begin() as db:
            stmt = queries.outdated_missions().where(mission.c.project_id == uuid.UUID(ref)).limit(_BATCH)
            stmt = stmt if after is None else stmt.where(mission.c.id > after)
            mission_ids = (await db.execute(stmt)).scalars().all()
            if not mission_ids:
                return
            after = await judge_missions(db, mission_ids, within_s=_BATCH_S) or mission_ids[-1]


async def judge_forgotten(db: Connection, *, limit: int) -> None:
    """Enqueue jobs for missions whose verdicts are outdated, and that have no queued or running job."""
    stmt = queries.outdated_missions().with_only_columns(cast(mission.c.id, Text)).limit(limit)
    stmt = stmt.where(~has_job(Job.judge_mission, mission.c.id), ~has_job(Job.judge_project, mission.c.project_id))
    await enqueue(db, Job.judge_mission, ids=(await db.execute(stmt)).scalars().all(), priority=Priority.low)
