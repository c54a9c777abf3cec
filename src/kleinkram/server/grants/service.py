"""Granting, changing and revoking rights.

Nobody grants more, or for longer, than they have themselves, nor changes a grant of a higher right than their own.
Every change begins with `lock_rights`.
"""

import datetime
import uuid
from typing import NamedTuple

from sqlalchemy import delete, func, literal, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.access import AccessRead, GrantCreate, GrantOn, GrantRead, GrantUpdate, Right
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, Forbidden, InvalidRequest, NotFound, RightExceeded
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import email_key
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.groups import email_group, own_group
from kleinkram.server.access.rights import ensure_owner_remains, lock_rights, require_mission, require_project
from kleinkram.server.access.visible import visible_groups, visible_people
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection
from kleinkram.server.grants.queries import (
    GRANT_ORDER,
    GrantPlace,
    access_on,
    grants_on,
    level_until,
    place_seen,
    to_access,
    to_grant,
)
from kleinkram.server.pagination import PageRequest, read_page
from kleinkram.server.tables import access_grant, access_group, person


class _Granter(NamedTuple):
    """The actor of a change, the place it is on, and the level of their own right there."""

    actor: Actor
    place: GrantPlace
    project_id: uuid.UUID
    level: int


async def list_grants(db: Connection, actor: Actor, *, place: GrantPlace, page: PageRequest) -> Page[GrantRead]:
    """Return a page of the grants on a place, by the name of the grantee.

    Raises NotFound, Forbidden, InvalidCursor.
    """
    await _require(db, actor, f"list_{place.on.value}_grants", place)
    return await read_page(db, grants_on(place), GRANT_ORDER, page, to_grant)


async def list_access(db: Connection, actor: Actor, *, place: GrantPlace, page: PageRequest) -> Page[AccessRead]:
    """Return a page of who has which right on a place and why; actors without WRITE see only their own.

    Raises NotFound, InvalidCursor.
    """
    await _require(db, actor, f"get_{place.on.value}_access", place)
    return await read_page(db, *access_on(actor, place), page, to_access)


async def create_grant(db: Connection, actor: Actor, *, place: GrantPlace, request: GrantCreate) -> GrantRead:
    """Grant a right and return the grant; it replaces the grantee's earlier grant on the place.

    A grant to an address has the same effect and response whether or not anybody has the address.

    Raises NotFound, Forbidden, RightExceeded, InvalidRequest, LastOwner.
    """
    granter = await _lock_granter(db, actor, f"create_{place.on.value}_grant", place)
    group_id, name = await _find_group(db, actor, request)
    of_group = grants_on(place).where(access_grant.c.group_id == group_id)
    row = (await db.execute(of_group)).one_or_none()
    old = None if row is None else to_grant(row)
    if old is not None and _is_same(old, request.right, request.expires_at):
        return old
    await _require_may_grant(db, granter, old, request.right, request.expires_at)
    grant_id = uuid.uuid4() if old is None else old.id
    operation = "grant.give" if old is None else "grant.change"
    after = _audit_values(request.right, request.expires_at)
    before = {} if old is None else _audit_values(old.right, old.expires_at)
    await _record(db, granter, operation, grant_id, name, before, after)
    values = {"level": request.right.level, "expires_at": request.expires_at, "granted_by_id": actor.person_id}
    inserted = upsert(access_grant).values(id=grant_id, group_id=group_id, **{place.key: place.id}, **values)
    changed = {**values, "created_at": func.now()}
    await db.execute(inserted.on_conflict_do_update(index_elements=[place.key, "group_id"], set_=changed))
    await _ensure_owner(db, place)
    return to_grant((await db.execute(of_group)).one())


async def update_grant(
    db: Connection, actor: Actor, *, place: GrantPlace, grant_id: uuid.UUID, changes: GrantUpdate
) -> GrantRead:
    """Change a grant and return it.

    Raises NotFound, Forbidden, RightExceeded, InvalidRequest, LastOwner.
    """
    granter = await _lock_granter(db, actor, f"update_{place.on.value}_grant", place)
    old = await _get_grant(db, place, grant_id)
    right = changes.right or old.right
    expires_at = changes.expires_at if "expires_at" in changes.model_fields_set else old.expires_at
    if _is_same(old, right, expires_at):
        return old
    await _require_may_grant(db, granter, old, right, expires_at)
    before, after = _audit_values(old.right, old.expires_at), _audit_values(right, expires_at)
    await _record(db, granter, "grant.change", grant_id, old.to.name, before, after)
    values = {"level": right.level, "expires_at": expires_at}
    await db.execute(update(access_grant).where(access_grant.c.id == grant_id).values(values))
    await _ensure_owner(db, place)
    return await _get_grant(db, place, grant_id)


async def delete_grant(db: Connection, actor: Actor, *, place: GrantPlace, grant_id: uuid.UUID) -> None:
    """Revoke a right.

    Raises NotFound, Forbidden, LastOwner.
    """
    granter = await _lock_granter(db, actor, f"delete_{place.on.value}_grant", place)
    old = await _get_grant(db, place, grant_id)
    _require_not_higher(granter, old)
    await _record(db, granter, "grant.revoke", grant_id, old.to.name, _audit_values(old.right, old.expires_at), {})
    await db.execute(delete(access_grant).where(access_grant.c.id == grant_id))
    await _ensure_owner(db, place)


async def _lock_granter(db: Connection, actor: Actor, operation: str, place: GrantPlace) -> _Granter:
    await lock_rights(db)
    await _require(db, actor, operation, place)
    row = (await db.execute(place_seen(actor, place))).one()
    return _Granter(actor, place, row.project_id, row.level)


async def _require(db: Connection, actor: Actor, operation: str, place: GrantPlace) -> None:
    require = require_project if place.on is GrantOn.project else require_mission
    await require(db, actor, operation, place.id)


async def _find_group(db: Connection, actor: Actor, request: GrantCreate) -> tuple[uuid.UUID, str]:
    if request.email is not None:
        return await email_group(db, request.email), email_key(request.email)
    if request.person_id is not None:
        stmt = visible_people(actor).where(person.c.id == request.person_id, person.c.deactivated_at.is_(None))
        if (row := (await db.execute(stmt)).one_or_none()) is None:
            raise NotFound(noun="person", ref=str(request.person_id))
        return await own_group(db, request.person_id), row.name
    stmt = visible_groups(actor).where(access_group.c.id == request.group_id)
    if (row := (await db.execute(stmt)).one_or_none()) is None:
        raise NotFound(noun="group", ref=str(request.group_id))
    return row.id, row.name


async def _get_grant(db: Connection, place: GrantPlace, grant_id: uuid.UUID) -> GrantRead:
    row = (await db.execute(grants_on(place).where(access_grant.c.id == grant_id))).one_or_none()
    if row is None:
        raise NotFound(noun="grant", ref=str(grant_id))
    return to_grant(row)


def _is_same(grant: GrantRead, right: Right, expires_at: datetime.datetime | None) -> bool:
    return grant.right is right and grant.expires_at == expires_at and not grant.has_expired


def _require_not_higher(granter: _Granter, grant: GrantRead | None) -> None:
    if grant is not None and grant.right.level > granter.level and not grant.has_expired:
        needs = grant.right.value
        raise Forbidden(noun=granter.place.on.value, operation=f"change a grant of {needs}", needs=needs)


async def _require_may_grant(
    db: Connection, granter: _Granter, old: GrantRead | None, right: Right, expires_at: datetime.datetime | None
) -> None:
    _require_not_higher(granter, old)
    if expires_at is not None and (await db.execute(select(literal(expires_at) <= func.now()))).scalar_one():
        raise InvalidRequest(problems=[FieldProblem(field="body.expires_at", message="has passed already")])
    lasting = (await db.execute(level_until(granter.actor, granter.place, expires_at))).scalar_one()
    if right.level > lasting:
        until = "without an end" if expires_at is None else f"until {expires_at:%Y-%m-%d %H:%M} UTC"
        own = Right.of_level(granter.level).value + ("" if right.level > granter.level else ", not as long")
        raise RightExceeded(noun=granter.place.on.value, requested=f"{right.value} {until}", own=own)


async def _ensure_owner(db: Connection, place: GrantPlace) -> None:
    if place.on is GrantOn.project:
        await ensure_owner_remains(db, [place.id])


async def _record(
    db: Connection, granter: _Granter, operation: str, grant_id: uuid.UUID, name: str, before: Metadata, after: Metadata
) -> None:
    # Before the change itself, so that the use of admin rights is judged by the actor's rights until then.
    place, has_delete = granter.place, Right.delete.value in (before.get("right"), after.get("right"))
    mission_id = place.id if place.on is GrantOn.mission else None
    takes = f"delete_{place.on.value}" if has_delete else None
    event = Event(
        operation, "grant", grant_id, name, granter.project_id, before, after, mission_id=mission_id, takes=takes
    )
    await record(db, granter.actor, event)


def _audit_values(right: Right, expires_at: datetime.datetime | None) -> Metadata:
    return {"right": right.value, "expires_at": None if expires_at is None else expires_at.isoformat()}
