"""Granting, changing and revoking rights.

Nobody grants more, or for longer, than they have themselves, nor changes a grant of a higher right than their own.
Every change begins with `lock_rights`.
"""

import datetime
import uuid
from dataclasses import dataclass
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.types import TypeEngine

from kleinkram.contract import access
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, Forbidden, InvalidRequest, NotFound, RightExceeded
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import PersonRef, email_key
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.builtin_groups import email_group, own_group
from kleinkram.server.access.rights import ensure_owner_remains, lock_rights, require_mission, require_project
from kleinkram.server.access.visible import (
    level_on_mission,
    level_on_mission_until,
    level_on_project,
    level_on_project_until,
    visible_groups,
    visible_missions,
    visible_people,
    visible_projects,
)
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.tables import access_grant, access_group, membership, mission, person, project

_grantee, _giver, _member = person.alias("grantee"), person.alias("giver"), person.alias("member")
_GRANTEE_NAME = sa.collate(sa.func.coalesce(_grantee.c.name, access_group.c.name), "C")
_KINDS = {
    access.GroupKind.person.value: access.GranteeKind.person,
    access.GroupKind.email.value: access.GranteeKind.email,
}
_GRANT_ORDER = Order([_GRANTEE_NAME, access_grant.c.id])


@dataclass(frozen=True)
class GrantResource:
    """The project or mission that a grant is on."""

    on: access.GrantOn
    id: uuid.UUID

    @property
    def key(self) -> str:
        """The column of a grant that refers to it."""
        return f"{self.on.value}_id"


_COLUMNS: dict[str, TypeEngine[Any]] = {
    "kind": sa.Text(),
    "to_id": sa.Uuid(),
    "to_name": sa.Text(),
    "person_id": sa.Uuid(),
    "person_name": sa.Text(),
    "level": sa.SmallInteger(),
    "through": sa.Text(),
    "grant_id": sa.Uuid(),
    "expires_at": sa.DateTime(timezone=True),
}


class _Granter(NamedTuple):
    """The actor of a change, the resource it is on, and the level of their own right there."""

    actor: Actor
    resource: GrantResource
    project_id: uuid.UUID
    level: int


async def list_grants(
    db: Connection, actor: Actor, *, resource: GrantResource, page: PageRequest
) -> Page[access.GrantRead]:
    """Return a page of the grants on a resource, by name of the grantee. Raises NotFound, Forbidden, InvalidCursor."""
    await _require(db, actor, f"list_{resource.on.value}_grants", resource)
    return await read_page(db, _grants_on(resource), _GRANT_ORDER, page, _to_grant)


async def list_access(
    db: Connection, actor: Actor, *, resource: GrantResource, page: PageRequest
) -> Page[access.AccessRead]:
    """Return a page of who has which right on a resource and why; actors without WRITE see only their own.

    Raises NotFound, InvalidCursor.
    """
    await _require(db, actor, f"get_{resource.on.value}_access", resource)
    return await read_page(db, *_access_on(actor, resource), page, _to_access)


async def create_grant(
    db: Connection, actor: Actor, *, resource: GrantResource, request: access.GrantCreate
) -> access.GrantRead:
    """Grant a right and return the grant; it replaces the grantee's earlier grant on the resource.

    A grant to an address has the same effect and response whether or not anybody has the address.

    Raises NotFound, Forbidden, RightExceeded, InvalidRequest, LastOwner.
    """
    granter = await _lock_granter(db, actor, f"create_{resource.on.value}_grant", resource)
    group_id, name = await _find_group(db, actor, request)
    of_group = _grants_on(resource).where(access_grant.c.group_id == group_id)
    row = (await db.execute(of_group)).one_or_none()
    old = None if row is None else _to_grant(row)
    if old is not None and _is_same(old, request.right, request.expires_at):
        return old
    await _require_may_grant(db, granter, old, request.right, request.expires_at)
    grant_id = uuid.uuid4() if old is None else old.id
    operation = "grant.create" if old is None else "grant.change"
    after = _audit_values(request.right, request.expires_at)
    before = {} if old is None else _audit_values(old.right, old.expires_at)
    await _record(db, granter, operation, grant_id, name, before, after)
    values = {"level": request.right.level, "expires_at": request.expires_at, "granted_by_id": actor.person_id}
    inserted = upsert(access_grant).values(id=grant_id, group_id=group_id, **{resource.key: resource.id}, **values)
    changed = {**values, "created_at": sa.func.now()}
    await db.execute(inserted.on_conflict_do_update(index_elements=[resource.key, "group_id"], set_=changed))
    await _ensure_owner(db, resource)
    return _to_grant((await db.execute(of_group)).one())


async def update_grant(
    db: Connection, actor: Actor, *, resource: GrantResource, grant_id: uuid.UUID, changes: access.GrantUpdate
) -> access.GrantRead:
    """Change a grant and return it. Raises NotFound, Forbidden, RightExceeded, InvalidRequest, LastOwner."""
    granter = await _lock_granter(db, actor, f"update_{resource.on.value}_grant", resource)
    old = await _get_grant(db, resource, grant_id)
    right = changes.right or old.right
    expires_at = changes.expires_at if "expires_at" in changes.model_fields_set else old.expires_at
    if _is_same(old, right, expires_at):
        return old
    await _require_may_grant(db, granter, old, right, expires_at)
    before, after = _audit_values(old.right, old.expires_at), _audit_values(right, expires_at)
    await _record(db, granter, "grant.change", grant_id, old.to.name, before, after)
    values = {"level": right.level, "expires_at": expires_at}
    await db.execute(sa.update(access_grant).where(access_grant.c.id == grant_id).values(values))
    await _ensure_owner(db, resource)
    return await _get_grant(db, resource, grant_id)


async def delete_grant(db: Connection, actor: Actor, *, resource: GrantResource, grant_id: uuid.UUID) -> None:
    """Revoke a right. Raises NotFound, Forbidden, LastOwner."""
    granter = await _lock_granter(db, actor, f"delete_{resource.on.value}_grant", resource)
    old = await _get_grant(db, resource, grant_id)
    _require_not_higher(granter, old)
    await _record(db, granter, "grant.revoke", grant_id, old.to.name, _audit_values(old.right, old.expires_at), {})
    await db.execute(sa.delete(access_grant).where(access_grant.c.id == grant_id))
    await _ensure_owner(db, resource)


async def _lock_granter(db: Connection, actor: Actor, operation: str, resource: GrantResource) -> _Granter:
    await lock_rights(db)
    await _require(db, actor, operation, resource)
    level = level_on_project if resource.on is access.GrantOn.project else level_on_mission
    row = (await db.execute(_visible_resource(actor, resource, project.c.id, level(actor).label("level")))).one()
    return _Granter(actor, resource, row.id, row.level)


async def _require(db: Connection, actor: Actor, operation: str, resource: GrantResource) -> None:
    require = require_project if resource.on is access.GrantOn.project else require_mission
    await require(db, actor, operation, resource.id)


async def _find_group(db: Connection, actor: Actor, request: access.GrantCreate) -> tuple[uuid.UUID, str]:
    if request.email is not None:
        return await email_group(db, request.email), email_key(request.email)
    if request.person_id is not None:
        stmt = visible_people(actor).where(person.c.id == request.person_id, person.c.deactivated_at.is_(None))
        if (row := (await db.execute(stmt)).one_or_none()) is None:
            raise NotFound(resource_type="person", ref=str(request.person_id))
        return await own_group(db, request.person_id), row.name
    stmt = visible_groups(actor).where(access_group.c.id == request.group_id)
    if (row := (await db.execute(stmt)).one_or_none()) is None:
        raise NotFound(resource_type="group", ref=str(request.group_id))
    return row.id, row.name


async def _get_grant(db: Connection, resource: GrantResource, grant_id: uuid.UUID) -> access.GrantRead:
    row = (await db.execute(_grants_on(resource).where(access_grant.c.id == grant_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="grant", ref=str(grant_id))
    return _to_grant(row)


def _is_same(grant: access.GrantRead, right: access.Right, expires_at: datetime.datetime | None) -> bool:
    return grant.right is right and grant.expires_at == expires_at and not grant.has_expired


def _require_not_higher(granter: _Granter, grant: access.GrantRead | None) -> None:
    if grant is not None and grant.right.level > granter.level and not grant.has_expired:
        needs = grant.right.value
        raise Forbidden(resource_type=granter.resource.on.value, operation=f"change a grant of {needs}", needs=needs)


async def _require_may_grant(
    db: Connection,
    granter: _Granter,
    old: access.GrantRead | None,
    right: access.Right,
    expires_at: datetime.datetime | None,
) -> None:
    _require_not_higher(granter, old)
    if expires_at is not None and (await db.execute(sa.select(sa.literal(expires_at) <= sa.func.now()))).scalar_one():
        raise InvalidRequest(problems=[FieldProblem(field="body.expires_at", message="has passed already")])
    resource, actor = granter.resource, granter.actor
    level = level_on_project_until if resource.on is access.GrantOn.project else level_on_mission_until
    lasting_level = (await db.execute(_visible_resource(actor, resource, level(actor, expires_at)))).scalar_one()
    if right.level > lasting_level:
        until = "without an end" if expires_at is None else f"until {expires_at:%Y-%m-%d %H:%M} UTC"
        own_right = access.Right.of_level(granter.level).value + (
            "" if right.level > granter.level else ", not as long"
        )
        raise RightExceeded(resource_type=resource.on.value, requested=f"{right.value} {until}", own=own_right)


async def _ensure_owner(db: Connection, resource: GrantResource) -> None:
    if resource.on is access.GrantOn.project:
        await ensure_owner_remains(db, [resource.id])


async def _record(
    db: Connection, granter: _Granter, operation: str, grant_id: uuid.UUID, name: str, before: Metadata, after: Metadata
) -> None:
    # Before the change itself, so that the use of admin rights is judged by the actor's rights until then.
    resource, has_delete = granter.resource, access.Right.delete.value in (before.get("right"), after.get("right"))
    mission_id = resource.id if resource.on is access.GrantOn.mission else None
    takes = f"delete_{resource.on.value}" if has_delete else None
    event = Event(
        operation, "grant", grant_id, name, granter.project_id, before, after, mission_id=mission_id, takes=takes
    )
    await audit(db, granter.actor, event)


def _audit_values(right: access.Right, expires_at: datetime.datetime | None) -> Metadata:
    return {"right": right.value, "expires_at": None if expires_at is None else expires_at.isoformat()}


def _visible_resource(actor: Actor, resource: GrantResource, *columns: sa.ColumnElement[Any]) -> sa.Select[Any]:
    """Return columns of a project or mission that is visible to the actor."""
    is_project = resource.on is access.GrantOn.project
    seen, table = (visible_projects(actor), project) if is_project else (visible_missions(actor), mission)
    return seen.where(table.c.id == resource.id).with_only_columns(*columns, maintain_column_froms=True)


def _grants_on(resource: GrantResource) -> sa.Select[Any]:
    """Return the grants on a resource for `_to_grant`, including expired ones."""
    return (
        sa.select(
            access_grant,
            access_group.c.kind,
            access_group.c.person_id,
            _GRANTEE_NAME.label("grantee_name"),
            _giver.c.name.label("granter_name"),
            (~unexpired(access_grant.c.expires_at)).label("has_expired"),
        )
        .join_from(access_grant, access_group, access_group.c.id == access_grant.c.group_id)
        .outerjoin(_grantee, _grantee.c.id == access_group.c.person_id)
        .outerjoin(_giver, _giver.c.id == access_grant.c.granted_by_id)
        .where(access_grant.c[resource.key] == resource.id)
    )


def _to_grant(row: sa.Row[Any]) -> access.GrantRead:
    """Return the grant in a row of `_grants_on`."""
    return access.GrantRead(
        id=row.id,
        on=access.GrantOn.project if row.project_id else access.GrantOn.mission,
        to=_to_grantee(row.kind, row.person_id or row.group_id, row.grantee_name),
        right=access.Right.of_level(row.level),
        expires_at=row.expires_at,
        has_expired=bool(row.has_expired),
        granted_at=row.created_at,
        granted_by=PersonRef(id=row.granted_by_id, name=row.granter_name) if row.granted_by_id else None,
    )


def _to_grantee(group_kind: str, grantee_id: uuid.UUID, name: str) -> access.Grantee:
    kind = _KINDS.get(group_kind, access.GranteeKind.group)
    return access.Grantee(kind=kind, id=None if kind is access.GranteeKind.email else grantee_id, name=name)


def _access_on(actor: Actor, resource: GrantResource) -> tuple[sa.Select[Any], Order]:
    """Return who has which right on a visible resource, one row for each reason, for `_to_access`; and the order.

    All of it where the actor has WRITE where the grant is; otherwise only their own and everybody's.
    """
    columns: list[sa.ColumnElement[Any]] = [project.c.id.label("project_id"), project.c.is_public]
    of_project = (level_on_project(actor) >= access.Right.write.level).label("of_project")
    if resource.on is access.GrantOn.project:
        columns += [sa.cast(sa.null(), sa.Uuid).label("mission_id"), of_project, sa.false().label("of_mission")]
    else:
        of_mission = (level_on_mission(actor) >= access.Right.write.level).label("of_mission")
        columns += [mission.c.id.label("mission_id"), of_project, of_mission]
    seen = _visible_resource(actor, resource, *columns).cte("seen")
    public = _reason(level=sa.literal(access.Right.read.level), through=sa.literal(access.AccessThrough.public.value))
    admins = _reason(level=sa.literal(access.Right.delete.level), through=sa.literal(access.AccessThrough.admin.value))
    reasons = sa.union_all(
        _granted(actor, seen),
        public.select_from(seen).where(seen.c.is_public),
        admins.select_from(seen).where(seen.c.of_project),
    ).subquery("way")
    return sa.select(reasons), Order([reasons.c.to_name, reasons.c.person_name, reasons.c.key])


def _to_access(row: sa.Row[Any]) -> access.AccessRead:
    """Return the access in a row of `_access_on`."""
    return access.AccessRead(
        person=PersonRef(id=row.person_id, name=row.person_name) if row.person_id else None,
        to=_to_grantee(row.kind, row.to_id, row.to_name) if row.kind else None,
        right=access.Right.of_level(row.level),
        through=access.AccessThrough(row.through),
        grant_id=row.grant_id,
        expires_at=row.expires_at,
    )


def _granted(actor: Actor, seen: sa.CTE) -> sa.Select[Any]:
    """Return the access by grants: a row for the grantee, or for each visible member of a group."""
    on_project = access_grant.c.project_id == seen.c.project_id
    is_own = sa.or_(access_group.c.person_id == actor.person_id, _member.c.id == actor.person_id)
    are_all_shown = sa.case((on_project, seen.c.of_project), else_=seen.c.of_mission)
    is_of_person = access_group.c.kind == access.GroupKind.person.value
    visible = visible_groups(actor).with_only_columns(access_group.c.id).correlate(None)
    members = membership.join(_member, (_member.c.id == membership.c.person_id) & _member.c.deactivated_at.is_(None))
    is_shown_member = sa.and_(
        membership.c.group_id == access_group.c.id,
        ~is_of_person,
        unexpired(membership.c.expires_at),
        sa.or_(access_group.c.id.in_(visible), membership.c.person_id == actor.person_id),
    )
    reason = _reason(
        kind=access_group.c.kind,
        to_id=sa.func.coalesce(access_group.c.person_id, access_group.c.id),
        to_name=_GRANTEE_NAME,
        person_id=sa.func.coalesce(_member.c.id, access_group.c.person_id),
        person_name=sa.func.coalesce(_member.c.name, _grantee.c.name, ""),
        level=access_grant.c.level,
        through=sa.case(
            (on_project, access.AccessThrough.project_grant.value), else_=access.AccessThrough.mission_grant.value
        ),
        grant_id=access_grant.c.id,
        expires_at=sa.func.least(access_grant.c.expires_at, membership.c.expires_at),
    )
    stmt = (
        reason.join_from(seen, access_grant, sa.or_(on_project, access_grant.c.mission_id == seen.c.mission_id))
        .join(access_group, access_group.c.id == access_grant.c.group_id)
        .outerjoin(_grantee, _grantee.c.id == access_group.c.person_id)
        .outerjoin(members, is_shown_member)
    )
    is_active = sa.or_(~is_of_person, _grantee.c.deactivated_at.is_(None))
    return stmt.where(unexpired(access_grant.c.expires_at), is_active, sa.or_(are_all_shown, is_own))


def _reason(**columns: sa.ColumnElement[Any]) -> sa.Select[Any]:
    """Return a select of `_COLUMNS`, null or empty where no column is passed, and a unique key."""
    defaults: dict[str, sa.ColumnElement[Any]] = {name: sa.null() for name in _COLUMNS}
    values = {**defaults, "to_name": sa.literal(""), "person_name": sa.literal(""), **columns}
    typed = {name: sa.cast(values[name], kind) for name, kind in _COLUMNS.items()}
    sortable = {name: sa.collate(value, "C") if name.endswith("_name") else value for name, value in typed.items()}
    key = sa.func.concat(typed["through"], typed["grant_id"], typed["person_id"])
    return sa.select(*(value.label(name) for name, value in sortable.items()), key.label("key"))
