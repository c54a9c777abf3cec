"""Selects of projects; they touch no connection."""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import ARRAY, BigInteger, ColumnElement, Row, Select, func, literal, select, type_coerce
from sqlalchemy.dialects.postgresql import array

from kleinkram.contract.access import Right
from kleinkram.contract.projects import ProjectRead, ProjectSort
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import level_on_project, sees_whole_missions, visible_projects
from kleinkram.server.db import by_name
from kleinkram.server.missions.queries import file_totals, total_duration
from kleinkram.server.pagination import Order
from kleinkram.server.tables import mission, person, project, upload
from kleinkram.server.tables.blobs import UNDER_WAY


def project_rows(actor: Actor, stmt: Select[Any]) -> Select[Any]:
    """Add the columns for `to_projects` to a select that began with `visible_projects`."""
    sees_all = sees_whole_missions(actor)
    # Quotas and unfinished uploads of others are not shown to actors without an account.
    sees_uploads = sees_all and actor.person_id is not None
    unsatisfied: ColumnElement[int] = literal(0)
    if sees_all:
        unsatisfied = func.count().filter(func.jsonb_array_length(mission.c.metadata_problems) > 0)
    files, size_bytes = file_totals(actor)
    contents = _sums(func.count(), unsatisfied, func.sum(files), func.sum(size_bytes), func.sum(total_duration(actor)))
    uploads = _sums(func.count(), func.sum(upload.c.size_bytes)).where(
        upload.c.state.in_(UNDER_WAY), upload.c.run_id.is_(None)
    )
    if not sees_uploads:
        uploads = uploads.where(upload.c.person_id == actor.person_id)
    uploads = uploads.join_from(mission, upload, upload.c.mission_id == mission.c.id)
    return stmt.add_columns(
        person.c.name.label("created_by_name"),
        literal(sees_all).label("sees_all"),
        literal(sees_uploads).label("sees_uploads"),
        level_on_project(actor).label("level"),
        contents.select_from(mission).scalar_subquery().label("contents"),
        uploads.scalar_subquery().label("uploads"),
    ).join(person, person.c.id == project.c.created_by_id)


def _sums(*numbers: ColumnElement[Any]) -> Select[Any]:
    # Several numbers from one pass over the rows.
    return (
        select(type_coerce(array([func.coalesce(number, 0) for number in numbers]), ARRAY(BigInteger)))
        .where(mission.c.project_id == project.c.id, mission.c.deleted_at.is_(None))
        .correlate(project)
    )


def to_projects(rows: Sequence[Row[Any]]) -> list[ProjectRead]:
    """Return the projects in rows of `project_rows`."""
    return [_to_project(values) for values in by_name(rows)]


def _to_project(values: dict[str, Any]) -> ProjectRead:
    mission_count, unsatisfied, file_count, size_bytes, duration_ns = (int(number) for number in values["contents"])
    upload_count, upload_bytes = (int(number) for number in values["uploads"])
    if not values["sees_all"]:
        values["description"] = ""
    if not values["sees_uploads"]:
        values |= {"quota_bytes": None, "quota_files": None}
    values["created_by"] = {"id": values["created_by_id"], "name": values["created_by_name"]}
    values |= {"mission_count": mission_count, "unsatisfied_mission_count": unsatisfied, "file_count": file_count}
    values |= {"size_bytes": size_bytes, "duration_ns": duration_ns}
    values |= {"used_bytes": size_bytes + upload_bytes, "used_files": file_count + upload_count}
    values["right"] = Right.of_level(values["level"])
    return ProjectRead.model_validate(values)


def lock_project(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return the select that locks a visible project, against changes and against missions created in it."""
    stmt = visible_projects(actor).with_only_columns(project.c.id).where(project.c.id == project_id)
    return stmt.with_for_update()


def project_order(sort: ProjectSort) -> Order:
    """Return the order of a list of projects."""
    column = project.c.name if sort.value.endswith("name") else project.c.created_at
    return Order([column, project.c.id], sort.value.startswith("-"))
