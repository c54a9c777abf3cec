"""Giving, changing and taking rights.

Nobody gives more, or for longer, than they hold themselves, nor touches a grant that is higher than what they hold.
Whatever changes a grant begins with `lock_rights`.
"""

import datetime
import uuid
from typing import Any, NamedTuple

from sqlalchemy import Row, delete, func, literal, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.emails import email_key
from kleinkram.contract.errors import FieldProblem, Forbidden, InvalidRequest, NotFound, RightExceeded
from kleinkram.contract.grants import AccessRead, GrantCreate, GrantOn, GrantRead, GrantUpdate
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.paging import Page
from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.email_groups import email_group
from kleinkram.server.access.groups import own_group
from kleinkram.server.access.ownership import ensure_owner_remains
from kleinkram.server.access.rights import lock_rights, require_mission, require_project
from kleinkram.server.access.visible import visible_groups, visible_people
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection
from kleinkram.server.grants import queries
from kleinkram.server.grants.access import access_on, to_access
from kleinkram.server.grants.queries import Place
from kleinkram.server.paging import PageRequest, fetch_page
from kleinkram.server.tables import access_grant, access_group, person


class Standing(NamedTuple):
    """Where somebody is about to change rights, and the level that they hold there themselves."""

    place: Place
    project_id: uuid.UUID
    level: int


class Change(NamedTuple):
    """What changes of one grant, as the record tells it; `name` is of whom it is to."""

    grant_id: uuid.UUID
    name: str
    before: Metadata
    after: Metadata


async def list_grants(db: Connection, actor: Actor, *, place: Place, page: PageRequest) -> Page[GrantRead]:
    """Return a page of the grants on a place, by the name of whom they are to.

    Raises:
        NotFound: the place is not there, or not for this actor.
        Forbidden: they may see it, but not who may do what there.
        InvalidCursor: the cursor is not of this list.
    """
    await _require(db, actor, f"list_{place.on.value}_grants", place)
    rows = await fetch_page(db, queries.grants_on(place), queries.grant_order(), page)
    return Page(items=[queries.to_grant(row) for row in rows.items], next=rows.next, total=rows.total)


async def list_access(db: Connection, actor: Actor, *, place: Place, page: PageRequest) -> Page[AccessRead]:
    """Return a page of who has a right on a place now, and by what; whoever holds less than WRITE sees their own part.

    Raises:
        NotFound: the place is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    await _require(db, actor, f"get_{place.on.value}_access", place)
    rows = await fetch_page(db, *access_on(actor, place), page)
    return Page(items=[to_access(row) for row in rows.items], next=rows.next, total=rows.total)


async def give(db: Connection, actor: Actor, *, place: Place, wanted: GrantCreate) -> GrantRead:
    """Give a right, in place of the one that was given there to the same one before, and return it.

    To an address it is given in the same way and with the same answer whether or not anybody has it.

    Raises:
        NotFound: the place, the person or the group is not there, or not for this actor.
        Forbidden: they may not give rights here, or not touch the one that is there.
        RightExceeded: it is more, or for longer, than they hold.
        InvalidRequest: its end has passed already.
        LastOwner: it takes the place of the last lasting owner's.
    """
    standing = await _standing(db, actor, f"create_{place.on.value}_grant", place)
    group_id, name = await _group_of(db, actor, wanted)
    of_group = queries.grants_on(place).where(access_grant.c.group_id == group_id)
    old = (await db.execute(of_group)).one_or_none()
    if old is not None and _says(old, wanted.right, wanted.expires_at):
        return queries.to_grant(old)
    _see_that_it_may_be_touched(standing, old)
    await _see_that_it_is_theirs_to_give(db, actor, standing, wanted.right, wanted.expires_at)
    grant_id = uuid.uuid4() if old is None else old.id
    operation = "grant.give" if old is None else "grant.change"
    after = _told(wanted.right, wanted.expires_at)
    await _record(db, actor, standing, operation, Change(grant_id, name, _of(old), after))
    values = {"level": wanted.right.level, "expires_at": wanted.expires_at, "granted_by_id": actor.person_id}
    given = upsert(access_grant).values(id=grant_id, group_id=group_id, **{place.key: place.id}, **values)
    again = {**values, "created_at": func.now()}
    await db.execute(given.on_conflict_do_update(index_elements=[place.key, "group_id"], set_=again))
    await _see_owners(db, place)
    return queries.to_grant((await db.execute(of_group)).one())


async def change(db: Connection, actor: Actor, *, place: Place, grant_id: uuid.UUID, changes: GrantUpdate) -> GrantRead:
    """Change what is given of a grant and return it.

    Raises:
        NotFound: the place or the grant is not there, or not for this actor.
        Forbidden, RightExceeded, InvalidRequest, LastOwner: as in `give`.
    """
    standing = await _standing(db, actor, f"update_{place.on.value}_grant", place)
    old = await _grant(db, place, grant_id)
    right = changes.right or Right.of_level(old.level)
    expires_at = changes.expires_at if "expires_at" in changes.model_fields_set else old.expires_at
    if _says(old, right, expires_at):
        return queries.to_grant(old)
    _see_that_it_may_be_touched(standing, old)
    await _see_that_it_is_theirs_to_give(db, actor, standing, right, expires_at)
    changed = Change(grant_id, old.grantee_name, _of(old), _told(right, expires_at))
    await _record(db, actor, standing, "grant.change", changed)
    values = {"level": right.level, "expires_at": expires_at}
    await db.execute(update(access_grant).where(access_grant.c.id == grant_id).values(values))
    await _see_owners(db, place)
    return queries.to_grant(await _grant(db, place, grant_id))


async def revoke(db: Connection, actor: Actor, *, place: Place, grant_id: uuid.UUID) -> None:
    """Take a right away.

    Raises:
        NotFound: the place or the grant is not there, or not for this actor.
        Forbidden: they may not take rights away here, or not this one.
        LastOwner: it is the last lasting owner's.
    """
    standing = await _standing(db, actor, f"delete_{place.on.value}_grant", place)
    old = await _grant(db, place, grant_id)
    _see_that_it_may_be_touched(standing, old)
    await _record(db, actor, standing, "grant.revoke", Change(grant_id, old.grantee_name, _of(old), {}))
    await db.execute(delete(access_grant).where(access_grant.c.id == grant_id))
    await _see_owners(db, place)


async def _standing(db: Connection, actor: Actor, operation: str, place: Place) -> Standing:
    await lock_rights(db)
    await _require(db, actor, operation, place)
    row = (await db.execute(queries.place_seen(actor, place))).one()
    return Standing(place, row.project_id, row.level)


async def _require(db: Connection, actor: Actor, operation: str, place: Place) -> None:
    require = require_project if place.on is GrantOn.project else require_mission
    await require(db, actor, operation, place.id)


async def _group_of(db: Connection, actor: Actor, wanted: GrantCreate) -> tuple[uuid.UUID, str]:
    if wanted.email is not None:
        return await email_group(db, wanted.email), email_key(wanted.email)
    if wanted.person_id is not None:
        found = visible_people(actor).where(person.c.id == wanted.person_id, person.c.deactivated_at.is_(None))
        if (row := (await db.execute(found)).one_or_none()) is None:
            raise NotFound(noun="person", ref=str(wanted.person_id))
        return await own_group(db, wanted.person_id), row.name
    found = visible_groups(actor).where(access_group.c.id == wanted.group_id)
    if (row := (await db.execute(found)).one_or_none()) is None:
        raise NotFound(noun="group", ref=str(wanted.group_id))
    return row.id, row.name


async def _grant(db: Connection, place: Place, grant_id: uuid.UUID) -> Row[Any]:
    found = queries.grants_on(place).where(access_grant.c.id == grant_id)
    if (row := (await db.execute(found)).one_or_none()) is None:
        raise NotFound(noun="grant", ref=str(grant_id))
    return row


def _says(grant: Row[Any], right: Right, expires_at: datetime.datetime | None) -> bool:
    return bool(grant.level == right.level and grant.expires_at == expires_at and not grant.has_expired)


def _see_that_it_may_be_touched(standing: Standing, grant: Row[Any] | None) -> None:
    if grant is not None and grant.level > standing.level and not grant.has_expired:
        needs = Right.of_level(grant.level).value
        raise Forbidden(noun=standing.place.on.value, operation=f"change a grant of {needs}", needs=needs)


async def _see_that_it_is_theirs_to_give(
    db: Connection, actor: Actor, standing: Standing, right: Right, expires_at: datetime.datetime | None
) -> None:
    if expires_at is not None and (await db.execute(select(literal(expires_at) <= func.now()))).scalar_one():
        raise InvalidRequest(problems=[FieldProblem(field="body.expires_at", message="has passed already")])
    lasting = (await db.execute(queries.level_until(actor, standing.place, expires_at))).scalar_one()
    if right.level > lasting:
        until = "without an end" if expires_at is None else f"until {expires_at:%Y-%m-%d %H:%M} UTC"
        own = Right.of_level(standing.level).value + ("" if right.level > standing.level else ", not as long")
        raise RightExceeded(noun=standing.place.on.value, requested=f"{right.value} {until}", own=own)


async def _see_owners(db: Connection, place: Place) -> None:
    if place.on is GrantOn.project:
        await ensure_owner_remains(db, [place.id])


async def _record(db: Connection, actor: Actor, standing: Standing, operation: str, change: Change) -> None:
    # Before the change itself, so that an admin's power is marked by the rights that they had until then.
    place, highest = standing.place, Right.delete.value in (change.before.get("right"), change.after.get("right"))
    event = Event(
        operation,
        "grant",
        change.grant_id,
        change.name,
        standing.project_id,
        change.before,
        change.after,
        mission_id=place.id if place.on is GrantOn.mission else None,
        takes=f"delete_{place.on.value}" if highest else None,
    )
    await record(db, actor, event)


def _of(grant: Row[Any] | None) -> Metadata:
    return {} if grant is None else _told(Right.of_level(grant.level), grant.expires_at)


def _told(right: Right, expires_at: datetime.datetime | None) -> Metadata:
    return {"right": right.value, "expires_at": None if expires_at is None else expires_at.isoformat()}
