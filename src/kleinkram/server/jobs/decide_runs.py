"""Requests that the actions that a project names start on a mission. The job is in `server/runs/jobs.py`."""

import uuid

from sqlalchemy import delete, select

from kleinkram.server.db import Connection
from kleinkram.server.jobs.queue import Job, Priority, enqueue
from kleinkram.server.tables import mission, project_action, project_action_mission


async def decide_again(db: Connection, mission_id: uuid.UUID) -> None:
    """Have it decided anew, after this transaction, which actions of its project start on a mission."""
    names_actions = select(project_action.c.id).join(mission, mission.c.project_id == project_action.c.project_id)
    if (await db.execute(names_actions.where(mission.c.id == mission_id).limit(1))).first() is None:
        return
    await db.execute(delete(project_action_mission).where(project_action_mission.c.mission_id == mission_id))
    await enqueue(db, Job.start_automatic_runs, ids=[str(mission_id)], priority=Priority.normal)
