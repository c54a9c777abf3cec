"""Who has a right on a place now, and by what: one row for each way. Returns a select; touches no connection.

Members of a group show to whoever may see the group; who has an address shows to nobody but themselves.
"""

from typing import Any

from sqlalchemy import (
    CTE,
    ColumnElement,
    DateTime,
    Row,
    Select,
    SmallInteger,
    Text,
    Uuid,
    and_,
    case,
    cast,
    collate,
    false,
    func,
    literal,
    null,
    or_,
    select,
    union_all,
)
from sqlalchemy.types import TypeEngine

from kleinkram.contract.grants import AccessRead, AccessThrough, GrantOn
from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.visible import (
    level_on_mission,
    level_on_project,
    visible_groups,
    visible_missions,
    visible_projects,
)
from kleinkram.server.grants.queries import Place, grantee, grantee_name, to_grantee
from kleinkram.server.paging import Order
from kleinkram.server.tables import access_grant, access_group, membership, mission, person, project

_member = person.alias("member")


def access_on(actor: Actor, place: Place) -> tuple[Select[Any], Order]:
    """Return who has what on a visible place, as `to_access` reads it, and its order: by name of whom it was given to.

    All of it, as far as `actor` holds WRITE where a grant stands; else only what is their own or everybody's.
    """
    seen = _seen(actor, place)
    ways = union_all(_granted(actor, seen), _public(seen), _admins(seen)).subquery("way")
    return select(ways), Order([ways.c.to_name, ways.c.person_name, ways.c.key])


def to_access(row: Row[Any]) -> AccessRead:
    """Return the way to a right that a row stands for."""
    return AccessRead(
        person=PersonRef(id=row.person_id, name=row.person_name) if row.person_id else None,
        to=to_grantee(row.kind, row.to_id, row.to_name) if row.kind else None,
        right=Right.of_level(row.level),
        through=AccessThrough(row.through),
        grant_id=row.grant_id,
        expires_at=row.expires_at,
    )


def _seen(actor: Actor, place: Place) -> CTE:
    """Return the place, whether it is public, and whether `actor` may see who else has rights on it."""
    writes = Right.write.level
    columns = (project.c.id.label("project_id"), project.c.is_public)
    of_project = (level_on_project(actor) >= writes).label("of_project")
    if place.on is GrantOn.project:
        one = visible_projects(actor).where(project.c.id == place.id)
        no_mission = cast(null(), Uuid).label("mission_id")
        return one.with_only_columns(*columns, no_mission, of_project, false().label("of_mission")).cte("seen")
    one = visible_missions(actor).where(mission.c.id == place.id)
    of_mission = (level_on_mission(actor) >= writes).label("of_mission")
    mission_id = mission.c.id.label("mission_id")
    return one.with_only_columns(*columns, mission_id, of_project, of_mission, maintain_column_froms=True).cte("seen")


def _granted(actor: Actor, seen: CTE) -> Select[Any]:
    on_project = access_grant.c.project_id == seen.c.project_id
    mine = or_(access_group.c.person_id == actor.person_id, _member.c.id == actor.person_id)
    all_shown = case((on_project, seen.c.of_project), else_=seen.c.of_mission)
    through = case((on_project, AccessThrough.project_grant.value), else_=AccessThrough.mission_grant.value)
    is_own = access_group.c.kind == GroupKind.person.value
    shown = visible_groups(actor).with_only_columns(access_group.c.id).correlate(None)
    members = membership.join(_member, (_member.c.id == membership.c.person_id) & _member.c.deactivated_at.is_(None))
    joined = and_(
        membership.c.group_id == access_group.c.id,
        ~is_own,
        unexpired(membership.c.expires_at),
        or_(access_group.c.id.in_(shown), membership.c.person_id == actor.person_id),
    )
    stmt = (
        _way(
            kind=access_group.c.kind,
            to_id=func.coalesce(access_group.c.person_id, access_group.c.id),
            to_name=grantee_name(),
            person_id=func.coalesce(_member.c.id, access_group.c.person_id),
            person_name=func.coalesce(_member.c.name, grantee.c.name, ""),
            level=access_grant.c.level,
            through=through,
            grant_id=access_grant.c.id,
            expires_at=func.least(access_grant.c.expires_at, membership.c.expires_at),
        )
        .join_from(seen, access_grant, or_(on_project, access_grant.c.mission_id == seen.c.mission_id))
        .join(access_group, access_group.c.id == access_grant.c.group_id)
        .outerjoin(grantee, grantee.c.id == access_group.c.person_id)
        .outerjoin(members, joined)
    )
    active = or_(~is_own, grantee.c.deactivated_at.is_(None))
    return stmt.where(unexpired(access_grant.c.expires_at), active, or_(all_shown, mine))


def _public(seen: CTE) -> Select[Any]:
    way = _way(level=literal(Right.read.level), through=literal(AccessThrough.public.value))
    return way.select_from(seen).where(seen.c.is_public)


def _admins(seen: CTE) -> Select[Any]:
    way = _way(level=literal(Right.delete.level), through=literal(AccessThrough.admin.value))
    return way.select_from(seen).where(seen.c.of_project)


_COLUMNS: dict[str, TypeEngine[Any]] = {
    "kind": Text(),
    "to_id": Uuid(),
    "to_name": Text(),
    "person_id": Uuid(),
    "person_name": Text(),
    "level": SmallInteger(),
    "through": Text(),
    "grant_id": Uuid(),
    "expires_at": DateTime(timezone=True),
}


def _way(**given: ColumnElement[Any]) -> Select[Any]:
    nothing: dict[str, ColumnElement[Any]] = {name: null() for name in _COLUMNS}
    nothing |= {"to_name": literal(""), "person_name": literal("")}
    values = {name: cast((nothing | given)[name], kind) for name, kind in _COLUMNS.items()}
    sortable = {name: collate(value, "C") if name.endswith("_name") else value for name, value in values.items()}
    key = func.concat(values["through"], values["grant_id"], values["person_id"])
    return select(*(value.label(name) for name, value in sortable.items()), key.label("key"))
