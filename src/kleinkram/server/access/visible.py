"""What somebody may see: the selects that every other select narrows. Rights are decided here and nowhere else.

A right is a grant to a group that one is in, on a project or on a mission; the highest one counts. Admins reach all,
and anybody may read what is public. A credential with limits reaches nothing outside of them, whoever carries it.
"""

from typing import Any

from sqlalchemy import ColumnElement, Select, and_, any_, case, false, func, literal, or_, select, true

from kleinkram.contract.rights import Right, Scope
from kleinkram.server.access.actor import Actor, ActorKind, unexpired
from kleinkram.server.db import among
from kleinkram.server.tables import access_grant, blob, file, membership, mission, project


def visible_projects(actor: Actor, right: Right = Right.read) -> Select[Any]:
    """Return the projects on which `actor` has a right. A right on a mission does not show its project here."""
    return select(project).where(project.c.deleted_at.is_(None), _reaches_project(actor, right))


def visible_missions(actor: Actor, right: Right = Right.read) -> Select[Any]:
    """Return the missions on which `actor` has a right, joined with their projects."""
    return (
        select(mission)
        .join(project, project.c.id == mission.c.project_id)
        .where(mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None), _reaches_mission(actor, right))
    )


def visible_files(actor: Actor, right: Right = Right.read) -> Select[Any]:
    """Return the files on which `actor` has a right, joined with their missions, projects and blobs."""
    live = (file.c.deleted_at.is_(None), mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    return _joined_files().where(*live, _reaches_file(actor, right))


def trashed_projects(actor: Actor) -> Select[Any]:
    """Return the projects in the trash that `actor` may have back."""
    return select(project).where(project.c.deleted_at.is_not(None), _reaches_project(actor, Right.delete))


def trashed_missions(actor: Actor) -> Select[Any]:
    """Return the missions in the trash by themselves that `actor` may have back, joined with their projects."""
    stmt = select(mission).join(project, project.c.id == mission.c.project_id)
    return stmt.where(mission.c.deleted_at.is_not(None), _reaches_mission(actor, Right.delete))


def trashed_files(actor: Actor) -> Select[Any]:
    """Return the files in the trash by themselves that `actor` may have back, joined as in `visible_files`."""
    return _joined_files().where(file.c.deleted_at.is_not(None), _reaches_file(actor, Right.delete))


def level_on_project(actor: Actor) -> ColumnElement[int]:
    """Return the level of `actor`'s right on each `project` of a select; 0 where there is none."""
    if actor.is_admin:
        return literal(Right.delete.level)
    return func.greatest(_public_level(), _granted_level(actor, access_grant.c.project_id == project.c.id, project))


def level_on_mission(actor: Actor) -> ColumnElement[int]:
    """Return the level of `actor`'s right on each `mission` of a select that holds its `project` too; 0 for none."""
    if actor.is_admin:
        return literal(Right.delete.level)
    if actor.kind is ActorKind.share:
        return literal(Right.read.level)
    place = or_(access_grant.c.project_id == mission.c.project_id, access_grant.c.mission_id == mission.c.id)
    return func.greatest(_public_level(), _granted_level(actor, place, mission))


def _joined_files() -> Select[Any]:
    return (
        select(file)
        .join(mission, mission.c.id == file.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(blob, blob.c.id == file.c.blob_id)
    )


def _reaches_project(actor: Actor, right: Right) -> ColumnElement[bool]:
    if actor.kind is ActorKind.share:
        return false()
    within = true() if actor.limits is None else among(project.c.id, actor.limits.project_ids)
    if actor.is_admin:
        return within
    granted = project.c.id == any_(_granted(actor, access_grant.c.project_id, right))
    return and_(within, _or_public(granted, right))


def _reaches_mission(actor: Actor, right: Right) -> ColumnElement[bool]:
    within: ColumnElement[bool] = true()
    if actor.limits is not None:
        places = among(mission.c.project_id, actor.limits.project_ids), among(mission.c.id, actor.limits.mission_ids)
        within = or_(*places)
    if actor.kind is ActorKind.share:
        return within if right is Right.read else false()
    if actor.is_admin:
        return within
    by_project = mission.c.project_id == any_(_granted(actor, access_grant.c.project_id, right))
    by_mission = mission.c.id == any_(_granted(actor, access_grant.c.mission_id, right))
    return and_(within, _or_public(or_(by_project, by_mission), right))


def _reaches_file(actor: Actor, right: Right) -> ColumnElement[bool]:
    reached = _reaches_mission(actor, right)
    if actor.limits is not None and actor.limits.file_ids is not None:
        reached = and_(reached, among(file.c.id, actor.limits.file_ids))
    if Scope.read not in actor.scopes:
        # Who may only upload sees the files they brought, so that an upload can be answered, and no other.
        reached = and_(reached, file.c.uploaded_by_id == actor.person_id)
    return reached


def _or_public(granted: ColumnElement[bool], right: Right) -> ColumnElement[bool]:
    return or_(granted, project.c.is_public) if right is Right.read else granted


def _public_level() -> ColumnElement[int]:
    return case((project.c.is_public, Right.read.level), else_=0)


def _my_grants(actor: Actor, *columns: ColumnElement[Any]) -> Select[Any]:
    return (
        select(*columns)
        .join_from(membership, access_grant, access_grant.c.group_id == membership.c.group_id)
        .where(
            membership.c.person_id == actor.person_id,
            unexpired(membership.c.expires_at),
            unexpired(access_grant.c.expires_at),
        )
    )


def _granted(actor: Actor, place: ColumnElement[Any], right: Right) -> ColumnElement[Any]:
    # One array, found once a statement: the same plan for few grants and for many.
    stmt = _my_grants(actor, place).where(place.is_not(None), access_grant.c.level >= right.level)
    return func.array(stmt.scalar_subquery())


def _granted_level(actor: Actor, place: ColumnElement[bool], outer: Any) -> ColumnElement[int]:
    highest = _my_grants(actor, func.coalesce(func.max(access_grant.c.level), 0)).where(place)
    return highest.correlate(outer).scalar_subquery()
