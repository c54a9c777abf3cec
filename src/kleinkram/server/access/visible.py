"""What somebody may see: the selects that every other select narrows. Rights are decided here and nowhere else.

A right is a grant to a group that one is in, on a project or on a mission; the highest one counts. Admins reach all,
and anybody may read what is public. A credential with limits reaches nothing outside of them, whoever carries it.
"""

import datetime
import functools
import uuid
from collections.abc import Callable, Collection
from typing import Any

from sqlalchemy import (
    ColumnElement,
    CompoundSelect,
    Select,
    and_,
    any_,
    case,
    false,
    func,
    literal,
    not_,
    or_,
    select,
    true,
    union_all,
)
from sqlalchemy.dialects.postgresql import aggregate_order_by

from kleinkram.contract.access import GroupKind, Right, Scope
from kleinkram.server.access.actor import Actor, ActorKind, unexpired
from kleinkram.server.db import among
from kleinkram.server.tables import (
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

# What says of a time of expiry that something is not over.
Still = Callable[[ColumnElement[Any]], ColumnElement[bool]]
# A column of a grant, and that of the row it is a grant on.
Place = tuple[ColumnElement[Any], ColumnElement[Any]]
# Putting these into words again with each request would cost about as much as asking the database for them: so much is
# kept of who asked last.
_CACHE_SIZE = 1000
# Whoever is in one of these together knows of each other; all admins of a server need not.
_SHARED = (GroupKind.custom.value, GroupKind.affiliation.value)
_GROUPS = (*_SHARED, GroupKind.admins.value)
_public = project.alias("public_project")


def visible_projects(actor: Actor, right: Right = Right.read) -> Select[Any]:
    """Return the projects on which `actor` has a right. A right on a mission does not show its project here."""
    return select(project).where(project.c.deleted_at.is_(None), _reaches_project(actor, right))


def visible_missions(actor: Actor, right: Right = Right.read) -> Select[Any]:
    """Return the missions on which `actor` has a right, joined with their projects."""
    live = (mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    return joined_missions().where(*live, _reaches_mission(actor, right))


def visible_files(actor: Actor, right: Right = Right.read) -> Select[Any]:
    """Return the files on which `actor` has a right, joined with their missions, projects and blobs."""
    live = (file.c.deleted_at.is_(None), mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    return joined_files().where(*live, _reaches_file(actor, right))


@functools.cache
def joined_missions() -> Select[Any]:
    """Return all missions joined with their projects: nothing is said here of who sees them."""
    return select(mission).join(project, project.c.id == mission.c.project_id)


@functools.cache
def joined_files() -> Select[Any]:
    """Return all files joined with their missions, projects and blobs: nothing is said here of who sees them."""
    # Each file has its blob. As an outer join the database leaves it out where nothing is asked of blobs.
    return (
        select(file)
        .join(mission, mission.c.id == file.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .outerjoin(blob, blob.c.id == file.c.blob_id)
    )


def reached_projects(actor: Actor) -> Select[Any]:
    """Return the projects that `actor` may know of, in the trash too: to say that one changed, and nothing of it."""
    return select(project).where(_reaches_project(actor, Right.read))


def reached_missions(actor: Actor) -> Select[Any]:
    """Return the missions that `actor` may know of, in the trash too, joined with their projects; for the same."""
    return joined_missions().where(_reaches_mission(actor, Right.read))


def standing(actor: Actor) -> Select[Any]:
    """Return a text that is another one as soon as what is granted to `actor`, or to everybody, is something else."""
    mine = (access_grant.c.group_id == any_(_memberships(actor.person_id))) & unexpired(access_grant.c.expires_at)
    place = func.coalesce(access_grant.c.project_id, access_grant.c.mission_id)
    granted = select(func.concat(place, " ", access_grant.c.level).label("said")).where(mine)
    public = select(func.concat(_public.c.id, " public").label("said")).where(_public.c.is_public)
    said = union_all(granted, public).subquery().c.said
    return select(func.md5(func.coalesce(func.string_agg(said, aggregate_order_by(literal(","), said)), "")))


def trashed_projects(actor: Actor) -> Select[Any]:
    """Return the projects in the trash that `actor` may have back."""
    return select(project).where(project.c.deleted_at.is_not(None), _reaches_project(actor, Right.delete))


def trashed_missions(actor: Actor) -> Select[Any]:
    """Return the missions in the trash by themselves that `actor` may have back, joined with their projects."""
    return joined_missions().where(mission.c.deleted_at.is_not(None), _reaches_mission(actor, Right.delete))


def trashed_files(actor: Actor) -> Select[Any]:
    """Return the files in the trash by themselves that `actor` may have back, joined as in `visible_files`."""
    return joined_files().where(file.c.deleted_at.is_not(None), _reaches_file(actor, Right.delete))


def sees_whole_missions(actor: Actor) -> bool:
    """Say whether a mission that `actor` sees shows all that is in it, its metadata too.

    By a link to some of its files it shows these and its name; who may only upload sees names, and what they brought.
    """
    return Scope.read in actor.scopes and (actor.limits is None or actor.limits.file_ids is None)


def shown_files(actor: Actor) -> ColumnElement[bool]:
    """Say of each `file` of a mission that `actor` sees whether it is shown to them."""
    shown: ColumnElement[bool] = true()
    if actor.limits is not None and actor.limits.file_ids is not None:
        shown = among(file.c.id, actor.limits.file_ids)
    if Scope.read not in actor.scopes:
        # Who may only upload sees the files they brought, so that an upload can be answered, and no other.
        shown = and_(shown, file.c.uploaded_by_id == actor.person_id)
    return shown


def shown_recordings(actor: Actor) -> ColumnElement[bool]:
    """Say of each `recording` of a mission that `actor` sees whether all files it is made of are shown to them."""
    if sees_whole_missions(actor):
        return true()
    member = select(file.c.id).where(file.c.recording_id == recording.c.id, file.c.deleted_at.is_(None))
    shown = shown_files(actor)
    members = (member.where(shown), member.where(not_(shown)))
    some, others = (each.correlate(recording).exists() for each in members)
    return and_(some, not_(others))


def shown_span(actor: Actor) -> tuple[ColumnElement[int | None], ColumnElement[int | None]]:
    """Return start and end of each `mission` of a select as far as its files are shown, in ns of the log clock."""
    if sees_whole_missions(actor):
        return mission.c.start_ns, mission.c.end_ns
    inside = (file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None), shown_files(actor))
    ends = (func.min(blob.c.start_ns), func.max(blob.c.end_ns))
    first, last = (
        select(end).join_from(file, blob, blob.c.id == file.c.blob_id).where(*inside).correlate(mission) for end in ends
    )
    return first.scalar_subquery(), last.scalar_subquery()


def level_on_project(actor: Actor) -> ColumnElement[int]:
    """Return the level of `actor`'s right on each `project` of a select; 0 where there is none."""
    if actor.is_admin:
        return literal(Right.delete.level)
    return func.greatest(
        _public_level(), _granted_level(actor.person_id, (access_grant.c.project_id, project.c.id), project)
    )


def level_on_mission(actor: Actor) -> ColumnElement[int]:
    """Return the level of `actor`'s right on each `mission` of a select that holds its `project` too; 0 for none."""
    if actor.is_admin:
        return _at_most(actor, literal(Right.delete.level))
    if actor.kind is ActorKind.share:
        return literal(Right.read.level)
    return _at_most(actor, _public_or_granted_level(actor.person_id))


def _at_most(actor: Actor, level: ColumnElement[int]) -> ColumnElement[int]:
    return level if actor.most is None else func.least(level, actor.most.level)


def lasting_level_on_project(actor: Actor, until: datetime.datetime | None) -> ColumnElement[int]:
    """Return the level of `actor`'s right on each `project` of a select that lasts until then, or for good."""
    if actor.is_admin:
        return literal(Right.delete.level)
    return _granted_level(actor.person_id, (access_grant.c.project_id, project.c.id), project, _lasting(until))


def lasting_level_on_mission(actor: Actor, until: datetime.datetime | None) -> ColumnElement[int]:
    """Return the same on each `mission` of a select."""
    if actor.is_admin:
        return literal(Right.delete.level)
    return func.greatest(*_levels_granted_on_mission(actor.person_id, _lasting(until)))


def visible_people(actor: Actor) -> Select[Any]:
    """Return the people whom `actor` may know of: active ones that share a group, a project or a mission with them.

    Whoever was let in by an e-mail address does not show by that, so that nobody learns who has which address. Admins
    see all, those who left too. What a limited token's carrier sees is themselves.
    """
    if actor.limits is not None:
        return select(person).where(person.c.id == actor.person_id)
    if actor.is_admin:
        return select(person)
    together = membership.alias("together")
    in_my_groups = select(together.c.person_id).where(
        together.c.group_id == any_(_my_groups(actor)), unexpired(together.c.expires_at)
    )
    known = person.c.id.in_(in_my_groups) | person.c.id.in_(_granted_where(actor))
    return select(person).where(or_(person.c.id == actor.person_id, and_(person.c.deactivated_at.is_(None), known)))


def visible_groups(actor: Actor) -> Select[Any]:
    """Return the groups that `actor` is in, of those that several people can be in; admins see all of these."""
    if actor.limits is not None:
        return select(access_group).where(false())
    if actor.is_admin:
        return select(access_group).where(access_group.c.kind.in_(_GROUPS))
    return select(access_group).where(access_group.c.id == any_(_my_groups(actor, _GROUPS)))


def knows_addresses(actor: Actor) -> ColumnElement[bool]:
    """Say of each `person` of a select whether `actor` may know their addresses: editors of a shared group, admins.

    Whom an editor put into the group by themselves does not count there: else whoever may make groups would learn the
    address of everybody whom they see.
    """
    if actor.limits is not None or actor.is_admin:
        return literal(actor.limits is None) | (person.c.id == actor.person_id)
    theirs = membership.alias("theirs")
    edited = select(theirs.c.person_id).where(
        theirs.c.group_id == any_(_my_groups(actor, editors_only=True)),
        unexpired(theirs.c.expires_at),
        theirs.c.added_by_id.is_distinct_from(actor.person_id),
    )
    return or_(person.c.id == actor.person_id, person.c.id.in_(edited))


def _my_groups(actor: Actor, kinds: Collection[str] = _SHARED, *, editors_only: bool = False) -> ColumnElement[Any]:
    mine = (membership.c.person_id == actor.person_id) & unexpired(membership.c.expires_at)
    stmt = select(membership.c.group_id).join(access_group, access_group.c.id == membership.c.group_id)
    stmt = stmt.where(mine, access_group.c.kind.in_(kinds))
    return func.array((stmt.where(membership.c.is_editor) if editors_only else stmt).scalar_subquery())


def _granted_where(actor: Actor) -> Select[Any]:
    """Return the ids of the people who were granted something on a project, or a mission, where `actor` was too."""
    theirs, group = membership.alias("granted"), access_group.alias("granted_group")
    granted = access_grant.alias("their_grant")
    my_projects = _granted(actor, access_grant.c.project_id, Right.read)
    my_missions = _granted(actor, access_grant.c.mission_id, Right.read)
    missions = select(mission.c.id).where(mission.c.project_id.in_(my_projects))
    shared = or_(
        granted.c.project_id.in_(my_projects),
        granted.c.mission_id.in_(my_missions),
        granted.c.mission_id.in_(missions),
    )
    return (
        select(theirs.c.person_id)
        .join_from(granted, group, (group.c.id == granted.c.group_id) & (group.c.kind != GroupKind.email.value))
        .join(theirs, theirs.c.group_id == group.c.id)
        .where(shared, unexpired(granted.c.expires_at), unexpired(theirs.c.expires_at))
    )


def _reaches_project(actor: Actor, right: Right) -> ColumnElement[bool]:
    if actor.kind is ActorKind.share or _is_beyond(actor, right):
        return false()
    within = true() if actor.limits is None else among(project.c.id, actor.limits.project_ids)
    if actor.is_admin:
        return within
    return and_(within, project.c.id.in_(_my_projects(actor.person_id, right)))


def _is_beyond(actor: Actor, right: Right) -> bool:
    return actor.most is not None and right.level > actor.most.level


def _reaches_mission(actor: Actor, right: Right) -> ColumnElement[bool]:
    if _is_beyond(actor, right):
        return false()
    within: ColumnElement[bool] = true()
    if actor.limits is not None:
        places = among(mission.c.project_id, actor.limits.project_ids), among(mission.c.id, actor.limits.mission_ids)
        within = or_(*places)
    if actor.kind is ActorKind.share:
        return within if right is Right.read else false()
    if actor.is_admin:
        return within
    return and_(within, _granted_on_mission(actor.person_id, right))


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _granted_on_mission(person_id: uuid.UUID | None, right: Right) -> ColumnElement[bool]:
    return or_(mission.c.project_id.in_(_my_projects(person_id, right)), _granted_itself(person_id, right))


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _granted_itself(person_id: uuid.UUID | None, right: Right) -> ColumnElement[bool]:
    return mission.c.id.in_(_granted_to(person_id, access_grant.c.mission_id, right))


def _reaches_file(actor: Actor, right: Right) -> ColumnElement[bool]:
    return and_(_reaches_mission(actor, right), shown_files(actor))


def _my_projects(person_id: uuid.UUID | None, right: Right) -> Select[Any] | CompoundSelect[Any]:
    granted = _granted_to(person_id, access_grant.c.project_id, right)
    return union_all(granted, select(_public.c.id).where(_public.c.is_public)) if right is Right.read else granted


def _public_level() -> ColumnElement[int]:
    return case((project.c.is_public, Right.read.level), else_=0)


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _memberships(person_id: uuid.UUID | None, still: Still = unexpired) -> ColumnElement[Any]:
    mine = select(membership.c.group_id).where(membership.c.person_id == person_id, still(membership.c.expires_at))
    return func.array(mine.correlate(None).scalar_subquery())


def _lasting(until: datetime.datetime | None) -> Still:
    if until is None:
        return lambda expires_at: expires_at.is_(None)
    return lambda expires_at: or_(expires_at.is_(None), expires_at >= until)


def _granted(actor: Actor, place: ColumnElement[Any], right: Right) -> Select[Any]:
    return _granted_to(actor.person_id, place, right)


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _granted_to(person_id: uuid.UUID | None, place: ColumnElement[Any], right: Right) -> Select[Any]:
    # Asked with IN and of nothing outside: found once a statement and hashed, however many grants there are.
    mine = (access_grant.c.group_id == any_(_memberships(person_id))) & unexpired(access_grant.c.expires_at)
    return select(place).where(mine, place.is_not(None), access_grant.c.level >= right.level).correlate(None)


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _public_or_granted_level(person_id: uuid.UUID | None) -> ColumnElement[int]:
    return func.greatest(_public_level(), *_levels_granted_on_mission(person_id))


def _levels_granted_on_mission(person_id: uuid.UUID | None, still: Still = unexpired) -> list[ColumnElement[int]]:
    # Two looks, each into its own index: with OR, the database may well go through all grants of all the groups.
    return [
        _granted_level(person_id, (access_grant.c.project_id, mission.c.project_id), mission, still),
        _granted_level(person_id, (access_grant.c.mission_id, mission.c.id), mission, still),
    ]


def _granted_level(
    person_id: uuid.UUID | None, place: Place, outer: Any, still: Still = unexpired
) -> ColumnElement[int]:
    # What lasts until some moment is asked for seldom, and each time of another.
    level = _level_granted_to if still is unexpired else _level_granted_to.__wrapped__
    return level(person_id, place, outer, still)


@functools.lru_cache(maxsize=_CACHE_SIZE)
def _level_granted_to(person_id: uuid.UUID | None, place: Place, outer: Any, still: Still) -> ColumnElement[int]:
    granted_on, here = place
    mine = (access_grant.c.group_id == any_(_memberships(person_id, still))) & still(access_grant.c.expires_at)
    highest = select(func.coalesce(func.max(access_grant.c.level), 0)).where(mine, granted_on == here)
    return highest.correlate(outer).scalar_subquery()
