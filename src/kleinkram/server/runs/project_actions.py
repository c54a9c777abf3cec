"""The actions that a project names: adds, lists and removes them."""

import uuid
from typing import Any

from sqlalchemy import Row, Select, delete, func, select
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.actions import ParametersWrong
from kleinkram.contract.errors import FieldProblem, InvalidRequest
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import PersonRef
from kleinkram.contract.project_actions import (
    DEFAULT_IDLE_S,
    ProjectActionAdd,
    ProjectActionList,
    ProjectActionRead,
    RunTrigger,
)
from kleinkram.contract.runs import ActionRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_project
from kleinkram.server.actions import service as actions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection
from kleinkram.server.jobs.rejudge import judge_projects_again
from kleinkram.server.tables import action, action_version, person, project, project_action, project_action_mission


async def list_project_actions(db: Connection, actor: Actor, *, project_id: uuid.UUID) -> ProjectActionList:
    """Return the actions that a project names, by name.

    Raises:
        NotFound: the project is not there, or not for this actor.
    """
    await require_project(db, actor, "list_project_actions", project_id)
    rows = await db.execute(_rows(project_id).order_by(action.c.name, action.c.id))
    return ProjectActionList(items=[_to_read(row) for row in rows])


async def add_project_action(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, requested: ProjectActionAdd
) -> ProjectActionRead:
    """Have an action run by itself on the missions of a project that are due from now on; again, to change when.

    Raises:
        NotFound: the project or the action is not there, or not for this actor.
        Forbidden: they may not change the project.
        InvalidRequest: the action is archived or of another project, or its parameters are invalid.
    """
    await require_project(db, actor, "add_project_action", project_id)
    version = await actions.get_version_to_run(db, actor, action_id=requested.action_id, number=None)
    name, of_project = version.definition.name, await _project_of(db, requested.action_id)
    if of_project not in {None, project_id}:
        message = f"{name} is an action of another project; publish it in this one, or for the whole lab"
        raise InvalidRequest(problems=[FieldProblem(field="action_id", message=message)])
    try:
        version.definition.fill_in(requested.parameters)
    except ParametersWrong as error:
        problems = [FieldProblem(field=f"parameters.{key}", message=text) for key, text in error.problems.items()]
        raise InvalidRequest(problems=problems) from error
    idle_s = (requested.idle_s or DEFAULT_IDLE_S) if requested.on is RunTrigger.idle else None
    values = {"project_id": project_id, "action_id": requested.action_id, "added_by_id": actor.person_id}
    when = {"trigger": requested.on.value, "idle_s": idle_s, "parameters": requested.parameters}
    changed = {**when, "added_by_id": actor.person_id, "created_at": func.now()}
    stmt = upsert(project_action).values(id=uuid.uuid4(), **values, **when)
    await db.execute(stmt.on_conflict_do_update(index_elements=["project_id", "action_id"], set_=changed))
    added = _to_read((await db.execute(_rows(project_id, requested.action_id))).one())
    await judge_projects_again(db, [project_id])
    after: Metadata = {"action": name, "on": requested.on.value}
    name = await _name_of(db, project_id)
    await audit(db, actor, Event("project.add_action", "project", project_id, name, project_id, after=after))
    return added


async def remove_project_action(db: Connection, actor: Actor, *, project_id: uuid.UUID, action_id: uuid.UUID) -> None:
    """Stop an action from running by itself, and its results from counting; its runs stay. Idempotent.

    Raises:
        NotFound: the project is not there, or not for this actor.
        Forbidden: they may not change the project.
    """
    await require_project(db, actor, "remove_project_action", project_id)
    own = (project_action.c.project_id == project_id, project_action.c.action_id == action_id)
    row = (await db.execute(_rows(project_id, action_id))).one_or_none()
    if row is None:
        return
    await db.execute(delete(project_action).where(*own))
    await judge_projects_again(db, [project_id])
    before: Metadata = {"action": row.name, "on": row.trigger}
    name = await _name_of(db, project_id)
    await audit(db, actor, Event("project.remove_action", "project", project_id, name, project_id, before))


async def _name_of(db: Connection, project_id: uuid.UUID) -> str:
    name: str = (await db.execute(select(project.c.name).where(project.c.id == project_id))).scalar_one()
    return name


async def _project_of(db: Connection, action_id: uuid.UUID) -> uuid.UUID | None:
    of_action = select(action.c.project_id).where(action.c.id == action_id)
    project_id: uuid.UUID | None = (await db.execute(of_action)).scalar_one()
    return project_id


def _rows(project_id: uuid.UUID, action_id: uuid.UUID | None = None) -> Select[Any]:
    latest = select(func.max(action_version.c.number)).where(action_version.c.action_id == action.c.id)
    decided = project_action_mission
    has_problem = (decided.c.project_action_id == project_action.c.id) & decided.c.problem.is_not(None)
    problem = select(decided.c.problem).where(has_problem).order_by(decided.c.decided_at.desc()).limit(1)
    count = select(func.count()).select_from(decided).where(has_problem)
    names = ("action_id", "trigger", "idle_s", "parameters", "added_by_id", "created_at")
    stmt = select(
        *(project_action.c[name] for name in names),
        action.c.name,
        latest.correlate(action).scalar_subquery().label("number"),
        person.c.name.label("added_by_name"),
        problem.correlate(project_action).scalar_subquery().label("problem"),
        count.correlate(project_action).scalar_subquery().label("problem_count"),
    ).join_from(project_action, action, action.c.id == project_action.c.action_id)
    stmt = stmt.join(person, person.c.id == project_action.c.added_by_id)
    stmt = stmt.where(project_action.c.project_id == project_id)
    return stmt if action_id is None else stmt.where(project_action.c.action_id == action_id)


def _to_read(row: Row[Any]) -> ProjectActionRead:
    return ProjectActionRead(
        action=ActionRef(id=row.action_id, name=row.name, version=row.number),
        on=RunTrigger(row.trigger),
        idle_s=row.idle_s,
        parameters=row.parameters,
        added_by=PersonRef(id=row.added_by_id, name=row.added_by_name),
        added_at=row.created_at,
        problem=row.problem,
        problem_count=row.problem_count,
    )
