"""Selects on grants and on the access that follows from them; they touch no connection."""

import datetime
import uuid
from dataclasses import dataclass
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

from kleinkram.contract.access import (
    AccessRead,
    AccessThrough,
    Grantee,
    GranteeKind,
    GrantOn,
    GrantRead,
    GroupKind,
    Right,
)
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.visible import (
    lasting_level_on_mission,
    lasting_level_on_project,
    level_on_mission,
    level_on_project,
    visible_groups,
    visible_missions,
    visible_projects,
)
from kleinkram.server.paging import Order
from kleinkram.server.tables import access_grant, access_group, membership, mission, person, project

# People whose own group a grantee's is, and whoever gave a grant.
grantee, giver = person.alias("grantee"), person.alias("giver")
_KINDS = {GroupKind.person.value: GranteeKind.person, GroupKind.email.value: GranteeKind.email}


@dataclass(frozen=True)
class GrantPlace:
    """What a grant is on: one project or one mission."""

    on: GrantOn
    id: uuid.UUID

    @property
    def key(self) -> str:
        """The name of the column of a grant that says so."""
        return f"{self.on.value}_id"


def place_seen(actor: Actor, place: GrantPlace) -> Select[Any]:
    """Return a visible place: `project_id`, and the `level` that `actor` holds there now."""
    project_id = project.c.id.label("project_id")
    if place.on is GrantOn.project:
        level = level_on_project(actor).label("level")
        return visible_projects(actor).with_only_columns(project_id, level).where(project.c.id == place.id)
    seen = visible_missions(actor).where(mission.c.id == place.id)
    return seen.with_only_columns(project_id, level_on_mission(actor).label("level"), maintain_column_froms=True)


def level_until(actor: Actor, place: GrantPlace, until: datetime.datetime | None) -> Select[Any]:
    """Return the level that `actor` will still hold on a visible place then, or for good."""
    if place.on is GrantOn.project:
        lasting = lasting_level_on_project(actor, until)
        return visible_projects(actor).with_only_columns(lasting).where(project.c.id == place.id)
    seen = visible_missions(actor).where(mission.c.id == place.id)
    return seen.with_only_columns(lasting_level_on_mission(actor, until), maintain_column_froms=True)


def grantee_name() -> ColumnElement[str]:
    """Return the name of whom a grant is to, of a select that joins `grantee`."""
    return collate(func.coalesce(grantee.c.name, access_group.c.name), "C")


def grants_on(place: GrantPlace) -> Select[Any]:
    """Return the grants on a place, as `to_grant` reads them; those that have expired too."""
    return (
        select(
            access_grant,
            access_group.c.kind,
            access_group.c.person_id,
            grantee_name().label("grantee_name"),
            giver.c.name.label("giver_name"),
            (~unexpired(access_grant.c.expires_at)).label("has_expired"),
        )
        .join_from(access_grant, access_group, access_group.c.id == access_grant.c.group_id)
        .outerjoin(grantee, grantee.c.id == access_group.c.person_id)
        .outerjoin(giver, giver.c.id == access_grant.c.granted_by_id)
        .where(access_grant.c[place.key] == place.id)
    )


def grant_order() -> Order:
    """Return a list's order: by the name of whom a right was given to."""
    return Order([grantee_name(), access_grant.c.id])


def to_grant(row: Row[Any]) -> GrantRead:
    """Return the grant that a row stands for."""
    return GrantRead(
        id=row.id,
        on=GrantOn.project if row.project_id else GrantOn.mission,
        to=to_grantee(row.kind, row.person_id or row.group_id, row.grantee_name),
        right=Right.of_level(row.level),
        expires_at=row.expires_at,
        has_expired=bool(row.has_expired),
        granted_at=row.created_at,
        granted_by=PersonRef(id=row.granted_by_id, name=row.giver_name) if row.granted_by_id else None,
    )


def to_grantee(kind: str, ref: uuid.UUID, name: str) -> Grantee:
    """Return whom a right is given to, from their group's kind."""
    told = _KINDS.get(kind, GranteeKind.group)
    return Grantee(kind=told, id=None if told is GranteeKind.email else ref, name=name)


_member = person.alias("member")


def access_on(actor: Actor, place: GrantPlace) -> tuple[Select[Any], Order]:
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


def _seen(actor: Actor, place: GrantPlace) -> CTE:
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
