"""What is asked of missions. Functions return selects; they touch no connection."""

import functools
import json
import uuid
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Row,
    Select,
    Update,
    bindparam,
    case,
    func,
    literal,
    null,
    select,
    update,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.access import Right
from kleinkram.contract.files import FileFilter
from kleinkram.contract.missions import MissionFilter, MissionOrder, MissionRead, MissionRef, MissionSort
from kleinkram.contract.projects import ProjectRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import (
    joined_missions,
    level_on_mission,
    sees_whole_missions,
    shown_span,
    visible_missions,
    visible_projects,
)
from kleinkram.server.db import among, by_name
from kleinkram.server.filters.metadata import metadata_key
from kleinkram.server.filters.missions import filter_missions, filter_missions_by_files
from kleinkram.server.filters.plan import NO_PLAN, SearchPlan
from kleinkram.server.missions.amounts import amounts
from kleinkram.server.pagination import Order, PagedQuery
from kleinkram.server.tables import blob, file, mission, person, project

_LAST, _FIRST = 2**63 - 1, -(2**63)
_AMOUNTS = ("file_count", "size_bytes", "message_count", "pending_file_count")


def mission_rows(actor: Actor, stmt: Select[Any]) -> Select[Any]:
    """Return the rows that `to_missions` reads, of a select that began with `visible_missions`."""
    start_ns, end_ns = shown_span(actor)
    extra = (
        project.c.name.label("project_name"),
        person.c.name.label("created_by_name"),
        literal(sees_whole_missions(actor)).label("is_whole"),
        level_on_mission(actor).label("level"),
        start_ns.label("shown_start_ns"),
        end_ns.label("shown_end_ns"),
        amounts(actor).label("amounts"),
    )
    return stmt.add_columns(*extra).join(person, person.c.id == mission.c.created_by_id)


def rows_of_found(actor: Actor, mission_id: ColumnElement[uuid.UUID]) -> Select[Any]:
    """Return the same rows of missions that the very statement around it has found among the visible ones."""
    return mission_rows(actor, joined_missions().where(mission.c.id == mission_id))


def to_missions(rows: Sequence[Row[Any]]) -> list[MissionRead]:
    """Return the missions that rows of `mission_rows` stand for."""
    return [_to_mission(values) for values in by_name(rows)]


def _to_mission(values: dict[str, Any]) -> MissionRead:
    values["project"] = {"id": values["project_id"], "name": values["project_name"]}
    values["created_by"] = {"id": values["created_by_id"], "name": values["created_by_name"]}
    if not values["is_whole"]:
        values |= {"metadata": {}, "metadata_yaml": None, "metadata_problems": [], "notes": ""}
    values |= zip(_AMOUNTS, map(int, values["amounts"]), strict=True)
    values["start_ns"], values["end_ns"] = values["shown_start_ns"], values["shown_end_ns"]
    values["recordings_current"] = values["derived_revision"] == values["files_revision"]
    values["right"] = Right.of_level(values["level"])
    return MissionRead.model_validate(values)


def to_mission_ref(row: Row[Any]) -> MissionRef:
    """Return a mission as named beside what it holds."""
    return MissionRef(id=row.id, name=row.name, project=ProjectRef(id=row.project_id, name=row.project_name))


def mission_by_id(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return a visible mission, with its project's name."""
    project_name = project.c.name.label("project_name")
    return visible_missions(actor).add_columns(project_name).where(mission.c.id == mission_id)


def whole_mission(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return a visible mission as `to_missions` reads it."""
    return mission_rows(actor, visible_missions(actor).where(mission.c.id == mission_id))


def lock_projects_of(mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return the select that keeps the projects of missions from being deleted, restored or dropped."""
    holding = select(mission.c.project_id).where(among(mission.c.id, mission_ids))
    locked = select(project.c.id).where(project.c.id.in_(holding)).order_by(project.c.id)
    return locked.with_for_update(read=True, key_share=True)


def lock_missions(mission_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return the select that holds others off changing missions and what they hold."""
    locked = select(mission.c.id).where(among(mission.c.id, mission_ids)).order_by(mission.c.id)
    return locked.with_for_update(key_share=True)


def fields_of_project(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return a visible project's metadata fields, locked so that they stay and the project is not deleted meanwhile."""
    one = visible_projects(actor).with_only_columns(project.c.name, project.c.metadata_fields)
    return one.where(project.c.id == project_id).with_for_update(read=True)


def fields_of_mission(mission_id: uuid.UUID) -> Select[Any]:
    """Return the metadata fields of the project that a mission is in, locked likewise; for who may write the mission.

    That is no right on the project, of which they see the name alone: they hear of the fields what their own metadata
    lacks.
    """
    one = select(project.c.name, project.c.metadata_fields).join(mission, mission.c.project_id == project.c.id)
    return one.where(mission.c.id == mission_id, project.c.deleted_at.is_(None)).with_for_update(read=True, of=project)


def mission_listing(
    actor: Actor,
    matching: MissionFilter,
    by_files: FileFilter | None = None,
    *,
    plan: SearchPlan = NO_PLAN,
    sort: MissionOrder,
) -> PagedQuery:
    """Return the visible missions that match, among those that a filter of files finds, where there is one."""
    matched = filter_missions(actor, visible_missions(actor), matching, plan)
    if by_files is not None:
        matched = filter_missions_by_files(actor, matched, by_files, plan)
    return PagedQuery(matched, mission_order(actor, sort), functools.partial(rows_of_found, actor))


def sampled_missions(actor: Actor, by_files: FileFilter, *, plan: SearchPlan, size: int) -> Select[Any]:
    """Return how many of the missions sampled by id match (`hits`), of how many (`sampled`), and the `last_id`."""
    sample = select(mission.c.id).order_by(mission.c.id).limit(size).cte("sample").prefix_with("MATERIALIZED")
    within = visible_missions(actor).where(mission.c.id.in_(select(sample.c.id)))
    matched = filter_missions_by_files(actor, within, by_files, plan)
    hits = matched.with_only_columns(mission.c.id, maintain_column_froms=True).subquery()
    return select(
        select(func.count()).select_from(hits).scalar_subquery().label("hits"),
        select(func.count()).select_from(sample).scalar_subquery().label("sampled"),
        select(sample.c.id).order_by(sample.c.id.desc()).limit(1).scalar_subquery().label("last_id"),
    )


def mission_order(actor: Actor, sort: MissionOrder) -> Order:
    """Return a list's order. Missions without a time, or without the field, come last, whichever way the list runs.

    Who sees no metadata sees no order by it either.
    """
    if not isinstance(sort, MissionSort):
        return _order_by_metadata(sort, is_seen=sees_whole_missions(actor))
    return _order_of_whole(sort) if sees_whole_missions(actor) else _order(sort, shown_span(actor)[0])


@functools.cache
def _order_of_whole(sort: MissionSort) -> Order:
    return _order(sort, mission.c.start_ns)


def _order(sort: MissionSort, start_ns: ColumnElement[int | None]) -> Order:
    descending = sort.value.startswith("-")
    unknown = literal(_FIRST if descending else _LAST, BigInteger)
    columns: dict[str, list[ColumnElement[Any]]] = {
        "name": [mission.c.name, project.c.name],
        "created": [mission.c.created_at],
        "start": [func.coalesce(start_ns, unknown)],
    }
    return Order([*columns[sort.value.removeprefix("-")], mission.c.id], descending)


def _order_by_metadata(sort: str, *, is_seen: bool) -> Order:
    descending = sort.startswith("-")
    path = sort.removeprefix("-").split(".")[1:]
    value = metadata_key(path) if is_seen else null()
    has_none = value.is_(None) if not descending else value.is_not(None)
    columns = [case((has_none, 1), else_=0), func.coalesce(value, bindparam(None, "", JSONB)), mission.c.id]
    return Order(columns, descending, name="meta." + json.dumps(path))


def visible_ids(actor: Actor, *, plan: SearchPlan, limit: int) -> Select[Any]:
    """Return the ids of the first visible missions, in no order."""
    return visible_missions(actor).with_only_columns(mission.c.id, maintain_column_froms=True).limit(limit)


def last_mission(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return the mission of a project that was made last, as `to_mission_ref` reads it."""
    newest = visible_missions(actor).add_columns(project.c.name.label("project_name"))
    return (
        newest.where(mission.c.project_id == project_id)
        .order_by(mission.c.created_at.desc(), mission.c.id.desc())
        .limit(1)
    )


def contents(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return the number and bytes of a visible mission's files."""
    amounts = select(func.count(file.c.id), func.coalesce(func.sum(blob.c.size_bytes), 0))
    inside = visible_missions(actor).with_only_columns(mission.c.id).where(mission.c.id == mission_id)
    return amounts.join_from(file, blob, blob.c.id == file.c.blob_id).where(
        file.c.mission_id.in_(inside), file.c.deleted_at.is_(None)
    )


def change_mission(mission_id: uuid.UUID, **values: object) -> Update:
    """Return the statement that changes one mission."""
    return update(mission).where(mission.c.id == mission_id).values(**values)


def metadata_of_project(project_id: uuid.UUID, *, after: uuid.UUID | None, limit: int) -> Select[Any]:
    """Return the next missions of a project, by id, with what they carry; those in the trash too."""
    stmt = select(mission.c.id, mission.c.metadata, mission.c.metadata_problems)
    stmt = stmt.where(mission.c.project_id == project_id).order_by(mission.c.id).limit(limit)
    return stmt if after is None else stmt.where(mission.c.id > after)


def set_problems() -> Update:
    """Return the statement that notes `problems` for the mission `ref`, to be run for many at once."""
    return update(mission).where(mission.c.id == bindparam("ref")).values(metadata_problems=bindparam("problems"))
