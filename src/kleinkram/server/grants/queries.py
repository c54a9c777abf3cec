"""Selects on grants and on the access that follows from them; they touch no connection.

Members of a group are shown to those who may see the group; the owner of an address is shown to nobody else.
"""

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
from kleinkram.server.pagination import Order
from kleinkram.server.tables import access_grant, access_group, membership, mission, person, project

_grantee, _granter, _member = person.alias("grantee"), person.alias("giver"), person.alias("member")
_GRANTEE_NAME = collate(func.coalesce(_grantee.c.name, access_group.c.name), "C")
_KINDS = {GroupKind.person.value: GranteeKind.person, GroupKind.email.value: GranteeKind.email}
GRANT_ORDER = Order([_GRANTEE_NAME, access_grant.c.id])


@dataclass(frozen=True)
class GrantPlace:
    """The project or mission that a grant is on."""

    on: GrantOn
    id: uuid.UUID

    @property
    def key(self) -> str:
        """The column of a grant that refers to it."""
        return f"{self.on.value}_id"


def place_seen(actor: Actor, place: GrantPlace) -> Select[tuple[uuid.UUID, int]]:
    """Return `project_id` of a visible place, and the `level` of the actor's right on it."""
    project_id = project.c.id.label("project_id")
    if place.on is GrantOn.project:
        level = level_on_project(actor).label("level")
        return visible_projects(actor).with_only_columns(project_id, level).where(project.c.id == place.id)
    seen = visible_missions(actor).where(mission.c.id == place.id)
    return seen.with_only_columns(project_id, level_on_mission(actor).label("level"), maintain_column_froms=True)


def level_until(actor: Actor, place: GrantPlace, until: datetime.datetime | None) -> Select[tuple[int]]:
    """Return the level of the right that the actor will still have on a visible place at a time, or permanently."""
    if place.on is GrantOn.project:
        level = lasting_level_on_project(actor, until)
        return visible_projects(actor).with_only_columns(level).where(project.c.id == place.id)
    seen = visible_missions(actor).where(mission.c.id == place.id)
    return seen.with_only_columns(lasting_level_on_mission(actor, until), maintain_column_froms=True)


def grants_on(place: GrantPlace) -> Select[Any]:
    """Return the grants on a place for `to_grant`, including expired ones."""
    return (
        select(
            access_grant,
            access_group.c.kind,
            access_group.c.person_id,
            _GRANTEE_NAME.label("grantee_name"),
            _granter.c.name.label("granter_name"),
            (~unexpired(access_grant.c.expires_at)).label("has_expired"),
        )
        .join_from(access_grant, access_group, access_group.c.id == access_grant.c.group_id)
        .outerjoin(_grantee, _grantee.c.id == access_group.c.person_id)
        .outerjoin(_granter, _granter.c.id == access_grant.c.granted_by_id)
        .where(access_grant.c[place.key] == place.id)
    )


def to_grant(row: Row[Any]) -> GrantRead:
    """Return the grant in a row of `grants_on`."""
    return GrantRead(
        id=row.id,
        on=GrantOn.project if row.project_id else GrantOn.mission,
        to=_to_grantee(row.kind, row.person_id or row.group_id, row.grantee_name),
        right=Right.of_level(row.level),
        expires_at=row.expires_at,
        has_expired=bool(row.has_expired),
        granted_at=row.created_at,
        granted_by=PersonRef(id=row.granted_by_id, name=row.granter_name) if row.granted_by_id else None,
    )


def _to_grantee(group_kind: str, grantee_id: uuid.UUID, name: str) -> Grantee:
    kind = _KINDS.get(group_kind, GranteeKind.group)
    return Grantee(kind=kind, id=None if kind is GranteeKind.email else grantee_id, name=name)


def access_on(actor: Actor, place: GrantPlace) -> tuple[Select[Any], Order]:
    """Return who has which right on a visible place, one row for each reason, for `to_access`; and the order.

    All of it where the actor has WRITE where the grant is; otherwise only their own and everybody's.
    """
    columns: list[ColumnElement[Any]] = [project.c.id.label("project_id"), project.c.is_public]
    of_project = (level_on_project(actor) >= Right.write.level).label("of_project")
    if place.on is GrantOn.project:
        columns += [cast(null(), Uuid).label("mission_id"), of_project, false().label("of_mission")]
        seen = visible_projects(actor).where(project.c.id == place.id).with_only_columns(*columns).cte("seen")
    else:
        of_mission = (level_on_mission(actor) >= Right.write.level).label("of_mission")
        columns += [mission.c.id.label("mission_id"), of_project, of_mission]
        missions = visible_missions(actor).where(mission.c.id == place.id)
        seen = missions.with_only_columns(*columns, maintain_column_froms=True).cte("seen")
    public = _reason(level=literal(Right.read.level), through=literal(AccessThrough.public.value))
    admins = _reason(level=literal(Right.delete.level), through=literal(AccessThrough.admin.value))
    reasons = union_all(
        _granted(actor, seen),
        public.select_from(seen).where(seen.c.is_public),
        admins.select_from(seen).where(seen.c.of_project),
    ).subquery("way")
    return select(reasons), Order([reasons.c.to_name, reasons.c.person_name, reasons.c.key])


def to_access(row: Row[Any]) -> AccessRead:
    """Return the access in a row of `access_on`."""
    return AccessRead(
        person=PersonRef(id=row.person_id, name=row.person_name) if row.person_id else None,
        to=_to_grantee(row.kind, row.to_id, row.to_name) if row.kind else None,
        right=Right.of_level(row.level),
        through=AccessThrough(row.through),
        grant_id=row.grant_id,
        expires_at=row.expires_at,
    )


def _granted(actor: Actor, seen: CTE) -> Select[Any]:
    """Return the access by grants: a row for the grantee, or for each visible member of a group."""
    on_project = access_grant.c.project_id == seen.c.project_id
    is_own = or_(access_group.c.person_id == actor.person_id, _member.c.id == actor.person_id)
    are_all_shown = case((on_project, seen.c.of_project), else_=seen.c.of_mission)
    is_of_person = access_group.c.kind == GroupKind.person.value
    visible = visible_groups(actor).with_only_columns(access_group.c.id).correlate(None)
    members = membership.join(_member, (_member.c.id == membership.c.person_id) & _member.c.deactivated_at.is_(None))
    is_shown_member = and_(
        membership.c.group_id == access_group.c.id,
        ~is_of_person,
        unexpired(membership.c.expires_at),
        or_(access_group.c.id.in_(visible), membership.c.person_id == actor.person_id),
    )
    reason = _reason(
        kind=access_group.c.kind,
        to_id=func.coalesce(access_group.c.person_id, access_group.c.id),
        to_name=_GRANTEE_NAME,
        person_id=func.coalesce(_member.c.id, access_group.c.person_id),
        person_name=func.coalesce(_member.c.name, _grantee.c.name, ""),
        level=access_grant.c.level,
        through=case((on_project, AccessThrough.project_grant.value), else_=AccessThrough.mission_grant.value),
        grant_id=access_grant.c.id,
        expires_at=func.least(access_grant.c.expires_at, membership.c.expires_at),
    )
    stmt = (
        reason.join_from(seen, access_grant, or_(on_project, access_grant.c.mission_id == seen.c.mission_id))
        .join(access_group, access_group.c.id == access_grant.c.group_id)
        .outerjoin(_grantee, _grantee.c.id == access_group.c.person_id)
        .outerjoin(members, is_shown_member)
    )
    is_active = or_(~is_of_person, _grantee.c.deactivated_at.is_(None))
    return stmt.where(unexpired(access_grant.c.expires_at), is_active, or_(are_all_shown, is_own))


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


def _reason(**columns: ColumnElement[Any]) -> Select[Any]:
    """Return a select of `_COLUMNS`, null or empty where no column is passed, and a unique key."""
    defaults: dict[str, ColumnElement[Any]] = {name: null() for name in _COLUMNS}
    values = {**defaults, "to_name": literal(""), "person_name": literal(""), **columns}
    typed = {name: cast(values[name], kind) for name, kind in _COLUMNS.items()}
    sortable = {name: collate(value, "C") if name.endswith("_name") else value for name, value in typed.items()}
    key = func.concat(typed["through"], typed["grant_id"], typed["person_id"])
    return select(*(value.label(name) for name, value in sortable.items()), key.label("key"))
