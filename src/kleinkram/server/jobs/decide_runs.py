"""Requests that the actions that a project names start on a mission. The job is in `server/runs/jobs.py`."""

import uuid
from collections.abc import Collection
from typing import Any

from sqlalchemy import ColumnElement, Text, delete, exists, func, literal, or_, select
from sqlalchemy.dialects.postgresql import ARRAY

from kleinkram.server.db import Connection
from kleinkram.server.jobs.queue import Job, Priority, enqueue
from kleinkram.server.tables import action_version, mission, project_action, project_action_mission, run


async def decide_again(db: Connection, mission_id: uuid.UUID) -> None:
    """Have it decided anew, after this transaction, which actions of its project start on a mission."""
    names_actions = select(project_action.c.id).join(mission, mission.c.project_id == project_action.c.project_id)
    if (await db.execute(names_actions.where(mission.c.id == mission_id).limit(1))).first() is None:
        return
    await db.execute(delete(project_action_mission).where(project_action_mission.c.mission_id == mission_id))
    await enqueue(db, Job.start_automatic_runs, ids=[str(mission_id)], priority=Priority.normal)


async def decide_again_by_metadata(
    db: Connection, mission_id: uuid.UUID, changed: Collection[str], *, by_run_id: uuid.UUID | None
) -> None:
    """Decide anew on the actions that read metadata which changed, by a run or else a person.

    What a run changes starts nothing if its own action reads metadata: two actions could start each other for ever.
    The caller's transaction holds the lock of the mission.
    """
    other = action_version.alias()
    of_run = select(run.c.version_id).where(run.c.id == by_run_id).scalar_subquery()
    is_circular = exists().where(other.c.id == of_run, _reads_metadata(other.c.definition))
    newest = select(func.max(other.c.number)).where(other.c.action_id == project_action.c.action_id)
    stmt = select(project_action.c.id).join(mission, mission.c.project_id == project_action.c.project_id)
    stmt = stmt.join(action_version, action_version.c.action_id == project_action.c.action_id)
    stmt = stmt.where(mission.c.id == mission_id, action_version.c.number == newest.scalar_subquery(), ~is_circular)
    reading = stmt.where(_reads_metadata(action_version.c.definition, changed))
    ids = (await db.execute(reading)).scalars().all()
    if ids:
        own = (project_action_mission.c.mission_id == mission_id, project_action_mission.c.project_action_id.in_(ids))
        await db.execute(delete(project_action_mission).where(*own))
        await enqueue(db, Job.start_automatic_runs, ids=[str(mission_id)], priority=Priority.normal)


def _reads_metadata(definition: ColumnElement[Any], names: Collection[str] | None = None) -> ColumnElement[bool]:
    """Whether an action declares that it reads one of these fields, or any. All choose the profiles of checks."""
    inputs = definition["inputs"]
    declared = inputs["metadata"]
    is_declared = func.jsonb_array_length(declared) > 0
    if names is not None:
        is_declared = declared.has_any(literal([*names], ARRAY(Text)))
    reads_all = (func.coalesce(inputs[name].as_boolean(), False) for name in ("checks", "reference"))
    return or_(*reads_all, func.coalesce(is_declared, False))
