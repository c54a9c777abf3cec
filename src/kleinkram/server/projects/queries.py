"""What is asked of projects. Functions return selects; they touch no connection."""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import (
    ARRAY,
    BigInteger,
    ColumnElement,
    Row,
    Select,
    Update,
    func,
    literal,
    select,
    type_coerce,
    update,
)
from sqlalchemy.dialects.postgresql import array

from kleinkram.contract.projects import ProjectRead, ProjectSort
from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import (
    level_on_project,
    sees_whole_missions,
    visible_projects,
)
from kleinkram.server.db import by_name
from kleinkram.server.filters.missions import filter_projects
from kleinkram.server.missions.amounts import duration, file_amounts
from kleinkram.server.paging import Order
from kleinkram.server.tables import mission, person, project, upload
from kleinkram.server.tables.upload import UNDER_WAY


def _amounts(*numbers: ColumnElement[Any]) -> Select[Any]:
    # Several numbers from one look at the rows; `int` of each where it is read, since sums are numeric.
    return (
        select(type_coerce(array([func.coalesce(number, 0) for number in numbers]), ARRAY(BigInteger)))
        .where(mission.c.project_id == project.c.id, mission.c.deleted_at.is_(None))
        .correlate(project)
    )


def _contents(actor: Actor) -> ColumnElement[Any]:
    unsatisfied: ColumnElement[Any] = literal(0)
    if sees_whole_missions(actor):
        unsatisfied = func.count().filter(func.jsonb_array_length(mission.c.metadata_problems) > 0)
    files, size_bytes = file_amounts(actor)
    numbers = (func.count(), unsatisfied, func.sum(files), func.sum(size_bytes), func.sum(duration(actor)))
    return _amounts(*numbers).select_from(mission).scalar_subquery().label("contents")


def _upload_amounts(actor: Actor) -> ColumnElement[Any]:
    stmt = _amounts(func.count(), func.sum(upload.c.size_bytes)).where(
        upload.c.state.in_(UNDER_WAY), upload.c.run_id.is_(None)
    )
    if not _knows_drafts(actor):
        stmt = stmt.where(upload.c.person_id == actor.person_id)
    joined = stmt.join_from(mission, upload, upload.c.mission_id == mission.c.id)
    return joined.scalar_subquery().label("uploads")


def _knows_drafts(actor: Actor) -> bool:
    """Say whether quotas and what is still on its way show to `actor`: to nobody without an account."""
    return sees_whole_missions(actor) and actor.person_id is not None


def project_rows(actor: Actor, stmt: Select[Any]) -> Select[Any]:
    """Return the rows that `to_projects` reads, of a select that began with `visible_projects`."""
    name = person.c.name.label("created_by_name")
    is_whole = literal(sees_whole_missions(actor)).label("is_whole")
    knows_drafts = literal(_knows_drafts(actor)).label("knows_drafts")
    level = level_on_project(actor).label("level")
    extra = stmt.add_columns(name, is_whole, knows_drafts, level, _contents(actor), _upload_amounts(actor))
    return extra.join(person, person.c.id == project.c.created_by_id)


def to_projects(rows: Sequence[Row[Any]]) -> list[ProjectRead]:
    """Return the projects that rows of `project_rows` stand for."""
    return [_to_project(said) for said in by_name(rows)]


def _to_project(said: dict[str, Any]) -> ProjectRead:
    mission_count, unsatisfied, file_count, size_bytes, duration_ns = (int(number) for number in said["contents"])
    upload_count, upload_bytes = (int(number) for number in said["uploads"])
    if not said["is_whole"]:
        said["description"] = ""
    if not said["knows_drafts"]:
        said |= {"quota_bytes": None, "quota_files": None}
    said["created_by"] = {"id": said["created_by_id"], "name": said["created_by_name"]}
    said |= {"mission_count": mission_count, "unsatisfied_mission_count": unsatisfied, "file_count": file_count}
    said |= {"size_bytes": size_bytes, "duration_ns": duration_ns}
    said |= {"used_bytes": size_bytes + upload_bytes, "used_files": file_count + upload_count}
    said["right"] = Right.of_level(said["level"])
    return ProjectRead.model_validate(said)


def project_by_id(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return a visible project."""
    return project_rows(actor, visible_projects(actor).where(project.c.id == project_id))


def lock_project(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return the select that holds others off changing a visible project, or making missions in it."""
    stmt = visible_projects(actor).with_only_columns(project.c.id).where(project.c.id == project_id)
    return stmt.with_for_update()


def matching_projects(actor: Actor, *, name: str | None, text: str | None) -> Select[Any]:
    """Return the visible projects that match, as `to_projects` reads them."""
    return project_rows(actor, filter_projects(actor, visible_projects(actor), name=name, text=text))


def project_order(sort: ProjectSort) -> Order:
    """Return the order of a list of projects."""
    column = project.c.name if sort.value.endswith("name") else project.c.created_at
    return Order([column, project.c.id], sort.value.startswith("-"))


def change_project(project_id: uuid.UUID, **values: object) -> Update:
    """Return the statement that changes one project."""
    return update(project).where(project.c.id == project_id).values(**values)
