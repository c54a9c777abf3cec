"""Selects of what an actor may see, which all other selects narrow. Rights are decided here and nowhere else.

A right is a grant to one of the actor's groups, on a project or on a mission; the highest one counts. Admins have all
rights, and everybody may read public projects. A credential with limits has no rights outside them.
"""

import datetime
import functools
import uuid
from collections.abc import Callable, Collection
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import aggregate_order_by

from kleinkram.contract.access import GroupKind, Right, Scope
from kleinkram.server.access.actor import Actor, ActorKind, unexpired
from kleinkram.server.db import among
from kleinkram.server.tables import (
    DERIVED_ORIGIN,
    access_grant,
    access_group,
    blob,
    file,
    membership,
    mission,
    person,
    project,
    recording,
)

# A condition on a time of expiry.
NotExpired = Callable[[sa.ColumnElement[Any]], sa.ColumnElement[bool]]
# A column of a grant, and the column that it refers to.
_GrantColumns = tuple[sa.ColumnElement[Any], sa.ColumnElement[Any]]
# Building these expressions again for each request would take about as long as executing them.
_CACHE_SIZE = 1000
# Members of these groups see each other; the admins of a server do not by that alone.
_SHARED = (GroupKind.custom.value, GroupKind.affiliation.value)
_GROUPS = (*_SHARED, GroupKind.admins.value)
_public = project.alias("public_project")


def visible_projects(actor: Actor, right: Right = Right.read) -> sa.Select[Any]:
    """Return the projects on which `actor` has a right; a right on a mission does not include its project."""
    return sa.select(project).where(project.c.deleted_at.is_(None), _has_right_on_project(actor, right))


def visible_missions(actor: Actor, right: Right = Right.read) -> sa.Select[Any]:
    """Return the missions on which `actor` has a right, joined with their projects."""
    return joined_missions().where(is_visible_mission(actor, right))


def is_visible_mission(actor: Actor, right: Right = Right.read) -> sa.ColumnElement[bool]:
    """Whether `actor` has a right on a mission that is joined with its project."""
    live = (mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    return sa.and_(*live, _has_right_on_mission(actor, right))


def visible_files(actor: Actor, right: Right = Right.read) -> sa.Select[Any]:
    """Return the files on which `actor` has a right, joined with their missions, projects and blobs."""
    live = (file.c.deleted_at.is_(None), mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    return joined_files().where(*live, _has_right_on_mission(actor, right), shown_files(actor))


@functools.cache
def joined_missions() -> sa.Select[Any]:
    """Return all missions joined with their projects, without conditions on rights."""
    return sa.select(mission).join(project, project.c.id == mission.c.project_id)


@functools.cache
def joined_files() -> sa.Select[Any]:
    """Return all files joined with their missions, projects and blobs, without conditions on rights."""
    # Every file has a blob. PostgreSQL drops an outer join if no column of it is used.
    return (
        sa.select(file)
        .join(mission, mission.c.id == file.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .outerjoin(blob, blob.c.id == file.c.blob_id)
    )


def watchable_projects(actor: Actor) -> sa.Select[Any]:
    """Return the projects whose changes `actor` may watch, including those in the trash."""
    return sa.select(project).where(_has_right_on_project(actor, Right.read))


def watchable_missions(actor: Actor) -> sa.Select[Any]:
    """Return the missions whose changes `actor` may watch, joined with their projects."""
    return joined_missions().where(_has_right_on_mission(actor, Right.read))


def rights_hash(actor: Actor) -> sa.Select[Any]:
    """Return a hash that changes when what is granted to `actor`, or to everybody, changes."""
    is_own = (access_grant.c.group_id == sa.any_(_memberships(actor.person_id))) & unexpired(access_grant.c.expires_at)
    resource_id = sa.func.coalesce(access_grant.c.project_id, access_grant.c.mission_id)
    granted = sa.select(sa.func.concat(resource_id, " ", access_grant.c.level).label("item")).where(is_own)
    public = sa.select(sa.func.concat(_public.c.id, " public").label("item")).where(_public.c.is_public)
    items = sa.union_all(granted, public).subquery().c.item
    return sa.select(
        sa.func.md5(sa.func.coalesce(sa.func.string_agg(items, aggregate_order_by(sa.literal(","), items)), ""))
    )


def trashed_projects(actor: Actor) -> sa.Select[Any]:
    """Return the projects in the trash that `actor` may restore."""
    return sa.select(project).where(project.c.deleted_at.is_not(None), _has_right_on_project(actor, Right.delete))


def trashed_missions(actor: Actor) -> sa.Select[Any]:
    """Return the missions that were deleted by themselves and that `actor` may restore, joined with their projects."""
    return joined_missions().where(mission.c.deleted_at.is_not(None), _has_right_on_mission(actor, Right.delete))


def trashed_files(actor: Actor) -> sa.Select[Any]:
    """Return the files that were deleted by themselves and that `actor` may restore, joined as in `visible_files`."""
    return joined_files().where(
        file.c.deleted_at.is_not(None), _has_right_on_mission(actor, Right.delete), shown_files(actor)
    )


def sees_whole_missions(actor: Actor) -> bool:
    """Whether `actor` sees everything in a visible mission, including its metadata.

    Links to some files show these and the mission's name; tokens for uploads show names and their own uploads.
    """
    return Scope.read in actor.scopes and (actor.limits is None or actor.limits.file_ids is None)


def shown_files(actor: Actor) -> sa.ColumnElement[bool]:
    """Whether each `file` of a visible mission is shown to `actor`."""
    shown: sa.ColumnElement[bool] = sa.true()
    if actor.limits is not None and actor.limits.file_ids is not None:
        shown = among(file.c.id, actor.limits.file_ids)
    if Scope.read not in actor.scopes:
        # Only the person's own uploads, which responses to uploads contain.
        shown = sa.and_(shown, file.c.uploaded_by_id == actor.person_id)
    return shown


def shown_recordings(actor: Actor) -> sa.ColumnElement[bool]:
    """Whether all files of each `recording` of a visible mission are shown to `actor`."""
    if sees_whole_missions(actor):
        return sa.true()
    member = sa.select(file.c.id).where(file.c.recording_id == recording.c.id, file.c.deleted_at.is_(None))
    shown = shown_files(actor)
    members = (member.where(shown), member.where(sa.not_(shown)))
    some, others = (stmt.correlate(recording).exists() for stmt in members)
    return sa.and_(some, sa.not_(others))


def shown_span(actor: Actor) -> tuple[sa.ColumnElement[int | None], sa.ColumnElement[int | None]]:
    """Return start and end, in ns of the log clock, of what the shown files of each `mission` of a select recorded."""
    if sees_whole_missions(actor):
        return mission.c.start_ns, mission.c.end_ns
    is_recorded = file.c.origin != DERIVED_ORIGIN
    inside = (file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None), is_recorded, shown_files(actor))
    ends = (sa.func.min(blob.c.start_ns), sa.func.max(blob.c.end_ns))
    first, last = (
        sa.select(end).join_from(file, blob, blob.c.id == file.c.blob_id).where(*inside).correlate(mission)
        for end in ends
    )
    return first.scalar_subquery(), last.scalar_subquery()


def level_on_project(actor: Actor) -> sa.ColumnElement[int]:
    """Return the level of `actor`'s right on each `project` of a select; 0 where there is none."""
    if actor.is_admin:
        return sa.literal(Right.delete.level)
    return sa.func.greatest(
        _public_level(), _granted_level(actor.person_id, (access_grant.c.project_id, project.c.id), project)
    )


def level_on_mission(actor: Actor) -> sa.ColumnElement[int]:
    """Return the level of `actor`'s right on each `mission` of a select that holds its `project` too; 0 for none."""
    if actor.is_admin:
        return _at_most(actor, sa.literal(Right.delete.level))
    if actor.kind is ActorKind.share:
        return sa.literal(Right.read.level)
    return _at_most(actor, _public_or_granted_level(actor.person_id))


def _at_most(actor: Actor, level: sa.ColumnElement[int]) -> sa.ColumnElement[int]:
    return level if actor.max_right is None else sa.func.least(level, actor.max_right.level)


def level_on_project_until(actor: Actor, until: datetime.datetime | None) -> sa.ColumnElement[int]:
    """Return the level of `actor`'s right on each `project` of a select that lasts until a time, or permanently."""
    if actor.is_admin:
        return sa.literal(Right.delete.level)
    return _granted_level(actor.person_id, (access_grant.c.project_id, project.c.id), project, _valid_until(until))


def level_on_mission_until(actor: Actor, until: datetime.datetime | None) -> sa.ColumnElement[int]:
    """Like `level_on_project_until`, for each `mission` of a select."""
    if actor.is_admin:
        return sa.literal(Right.delete.level)
    return sa.func.greatest(*_levels_granted_on_mission(actor.person_id, _valid_until(until)))


def visible_people(actor: Actor) -> sa.Select[Any]:
    """Return the active people who share a group, a project or a mission with `actor`; admins see everybody.

    Grants to addresses do not count, because they would reveal who has which address. Limited tokens show only their
    holder.
    """
    if actor.limits is not None:
        return sa.select(person).where(person.c.id == actor.person_id)
    if actor.is_admin:
        return sa.select(person)
    together = membership.alias("together")
    in_my_groups = sa.select(together.c.person_id).where(
        together.c.group_id == sa.any_(_my_groups(actor)), unexpired(together.c.expires_at)
    )
    is_known = person.c.id.in_(in_my_groups) | person.c.id.in_(_granted_where(actor))
    return sa.select(person).where(
        sa.or_(person.c.id == actor.person_id, sa.and_(person.c.deactivated_at.is_(None), is_known))
    )


def visible_groups(actor: Actor) -> sa.Select[Any]:
    """Return the groups, of the kinds that can have several members, that `actor` is in; admins see all."""
    if actor.limits is not None:
        return sa.select(access_group).where(sa.false())
    if actor.is_admin:
        return sa.select(access_group).where(access_group.c.kind.in_(_GROUPS))
    return sa.select(access_group).where(access_group.c.id == sa.any_(_my_groups(actor, _GROUPS)))


def may_see_addresses(actor: Actor) -> sa.ColumnElement[bool]:
    """Whether `actor` may know the addresses of each `person` of a select: as editor of a shared group, or as admin.

    People whom the editor added do not count: everybody who may create groups would learn everybody's address.
    """
    if actor.limits is not None or actor.is_admin:
        return sa.literal(actor.limits is None) | (person.c.id == actor.person_id)
    others = membership.alias("theirs")
    people_in_edited_groups = sa.select(others.c.person_id).where(
        others.c.group_id == sa.any_(_my_groups(actor, editors_only=True)),
        unexpired(others.c.expires_at),
        others.c.added_by_id.is_distinct_from(actor.person_id),
    )
    return sa.or_(person.c.id == actor.person_id, person.c.id.in_(people_in_edited_groups))


def _my_groups(actor: Actor, kinds: Collection[str] = _SHARED, *, editors_only: bool = False) -> sa.ColumnElement[Any]:
    is_own = (membership.c.person_id == actor.person_id) & unexpired(membership.c.expires_at)
    stmt = sa.select(membership.c.group_id).join(access_group, access_group.c.id == membership.c.group_id)
    stmt = stmt.where(is_own, access_group.c.kind.in_(kinds))
    return sa.func.array((stmt.where(membership.c.is_editor) if editors_only else stmt).scalar_subquery())


def _granted_where(actor: Actor) -> sa.Select[Any]:
    """Return the ids of the people who have a grant on a project or mission on which `actor` has one."""
    others, group = membership.alias("granted"), access_group.alias("granted_group")
    grant = access_grant.alias("their_grant")
    my_projects = _granted_to(actor.person_id, access_grant.c.project_id, Right.read)
    my_missions = _granted_to(actor.person_id, access_grant.c.mission_id, Right.read)
    missions = sa.select(mission.c.id).where(mission.c.project_id.in_(my_projects))
    is_shared = sa.or_(
        grant.c.project_id.in_(my_projects),
        grant.c.mission_id.in_(my_missions),
        grant.c.mission_id.in_(missions),
    )
    return (
        sa.select(others.c.person_id)
        .join_from(grant, group, (group.c.id == grant.c.group_id) & (group.c.kind != GroupKind.email.value))
        .join(others, others.c.group_id == group.c.id)
        .where(is_shared, unexpired(grant.c.expires_at), unexpired(others.c.expires_at))
    )


def _has_right_on_project(actor: Actor, right: Right) -> sa.ColumnElement[bool]:
    if actor.kind is ActorKind.share or _exceeds_max_right(actor, right):
        return sa.false()
    in_limits = sa.true() if actor.limits is None else among(project.c.id, actor.limits.project_ids)
    if actor.is_admin:
        return in_limits
    return sa.and_(in_limits, project.c.id.in_(_my_projects(actor.person_id, right)))


def _exceeds_max_right(actor: Actor, right: Right) -> bool:
    return actor.max_right is not None and right.level > actor.max_right.level


def _has_right_on_mission(actor: Actor, right: Right) -> sa.ColumnElement[bool]:
    if _exceeds_max_right(actor, right):
        return sa.false()
    in_limits: sa.ColumnElement[bool] = sa.true()
    if actor.limits is not None:
        in_project = among(mission.c.project_id, actor.limits.project_ids)
        in_limits = in_project | among(mission.c.id, actor.limits.mission_ids)
    if actor.kind is ActorKind.share:
        return in_limits if right is Right.read else sa.false()
    if actor.is_admin:
        return in_limits
    return sa.and_(in_limits, _granted_on_mission(actor.person_id, right))


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _granted_on_mission(person_id: uuid.UUID | None, right: Right) -> sa.ColumnElement[bool]:
    by_mission = mission.c.id.in_(_granted_to(person_id, access_grant.c.mission_id, right))
    return sa.or_(mission.c.project_id.in_(_my_projects(person_id, right)), by_mission)


def _my_projects(person_id: uuid.UUID | None, right: Right) -> sa.Select[Any] | sa.CompoundSelect[Any]:
    granted = _granted_to(person_id, access_grant.c.project_id, right)
    return sa.union_all(granted, sa.select(_public.c.id).where(_public.c.is_public)) if right is Right.read else granted


def _public_level() -> sa.ColumnElement[int]:
    return sa.case((project.c.is_public, Right.read.level), else_=0)


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _memberships(person_id: uuid.UUID | None, still: NotExpired = unexpired) -> sa.ColumnElement[Any]:
    groups = sa.select(membership.c.group_id).where(membership.c.person_id == person_id, still(membership.c.expires_at))
    return sa.func.array(groups.correlate(None).scalar_subquery())


def _valid_until(until: datetime.datetime | None) -> NotExpired:
    if until is None:
        return lambda expires_at: expires_at.is_(None)
    return lambda expires_at: sa.or_(expires_at.is_(None), expires_at >= until)


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _granted_to(person_id: uuid.UUID | None, resource: sa.ColumnElement[Any], right: Right) -> sa.Select[Any]:
    # For IN, uncorrelated: evaluated once per statement and hashed, for any number of grants.
    is_own = (access_grant.c.group_id == sa.any_(_memberships(person_id))) & unexpired(access_grant.c.expires_at)
    return sa.select(resource).where(is_own, resource.is_not(None), access_grant.c.level >= right.level).correlate(None)


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _public_or_granted_level(person_id: uuid.UUID | None) -> sa.ColumnElement[int]:
    return sa.func.greatest(_public_level(), *_levels_granted_on_mission(person_id))


def _levels_granted_on_mission(
    person_id: uuid.UUID | None, still: NotExpired = unexpired
) -> list[sa.ColumnElement[int]]:
    # Two subqueries with an index each: with OR, PostgreSQL may scan all grants of the groups.
    return [
        _granted_level(person_id, (access_grant.c.project_id, mission.c.project_id), mission, still),
        _granted_level(person_id, (access_grant.c.mission_id, mission.c.id), mission, still),
    ]


def _granted_level(
    person_id: uuid.UUID | None, resource: _GrantColumns, outer: Any, still: NotExpired = unexpired
) -> sa.ColumnElement[int]:
    # Levels until a given time are rare, and each is different: do not cache them.
    level = _level_granted_to if still is unexpired else _level_granted_to.__wrapped__
    return level(person_id, resource, outer, still)


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _level_granted_to(
    person_id: uuid.UUID | None, resource: _GrantColumns, outer: Any, still: NotExpired
) -> sa.ColumnElement[int]:
    grant_column, resource_column = resource
    is_own = (access_grant.c.group_id == sa.any_(_memberships(person_id, still))) & still(access_grant.c.expires_at)
    highest = sa.select(sa.func.coalesce(sa.func.max(access_grant.c.level), 0))
    highest = highest.where(is_own, grant_column == resource_column)
    return highest.correlate(outer).scalar_subquery()
