"""What may be done with people. Whatever takes the power of an admin, or somebody's account, begins with `lock_rights`.

Who leaves keeps their name in the record, their memberships and their grants: all of it is back when they are. What
ends for good are their sessions, tokens and one-time codes, and the links they made: they know the secret of each.
"""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row, Table, delete, func, select, update

from kleinkram.contract.errors import NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.paging import Page
from kleinkram.contract.people import Departure, PersonRead, PersonRef
from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.groups import ADMINS_ID, make_admin
from kleinkram.server.access.ownership import ensure_admin_remains, give_to_admins
from kleinkram.server.access.rights import lock_rights
from kleinkram.server.audit.service import Event, record, record_all
from kleinkram.server.auth.one_time_codes import revoke_codes
from kleinkram.server.db import Connection
from kleinkram.server.paging import PageRequest, fetch_page
from kleinkram.server.people import queries
from kleinkram.server.tables import membership, person, session, share, token


async def list_people(
    db: Connection, actor: Actor, *, text: str | None, active: bool | None, page: PageRequest
) -> Page[PersonRead]:
    """Return a page of the people that `actor` may know of, by name.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    rows = await fetch_page(db, queries.matching_people(actor, text=text, active=active), queries.PEOPLE_ORDER, page)
    return Page(items=[queries.to_person(row) for row in rows.items], next=rows.next, total=rows.total)


async def get_person(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Return somebody.

    Raises:
        NotFound: there is nobody of that id whom `actor` may know of.
    """
    row = (await db.execute(queries.people_seen(actor).where(person.c.id == person_id))).one_or_none()
    if row is None:
        raise NotFound(noun="person", ref=str(person_id))
    return queries.to_person(row)


async def appoint(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Make somebody an admin for good; nothing happens where they are.

    Raises:
        NotFound: there is nobody of that id, or they left.
    """
    await lock_rights(db)
    row = await _active(db, person_id)
    mine = (membership.c.group_id == ADMINS_ID) & (membership.c.person_id == person_id)
    held = (await db.execute(select(membership.c.expires_at).where(mine))).one_or_none()
    if held is None or held.expires_at is not None:
        await record(db, actor, Event("person.make_admin", "person", person_id, row.name, None, by_power=True))
        await make_admin(db, person_id)
    return await get_person(db, actor, person_id)


async def dismiss(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Take the power of an admin from somebody; nothing happens where they have none.

    Raises:
        NotFound: there is nobody of that id.
        LastAdmin: they are the last lasting one.
    """
    await lock_rights(db)
    seen = await get_person(db, actor, person_id)
    mine = (membership.c.group_id == ADMINS_ID) & (membership.c.person_id == person_id)
    if (await db.execute(select(membership.c.group_id).where(mine))).first() is not None:
        await record(db, actor, Event("person.unmake_admin", "person", person_id, seen.name, None, by_power=True))
        await db.execute(delete(membership).where(mine))
        await ensure_admin_remains(db)
        seen = seen.model_copy(update={"is_admin": False})
    return seen


async def deactivate(db: Connection, actor: Actor, person_id: uuid.UUID) -> Departure:
    """End somebody's sessions, tokens and links, and give the projects that only they owned to the admins.

    Raises:
        NotFound: there is nobody of that id, or they left already.
        LastAdmin: they are the last lasting admin.
    """
    await lock_rights(db)
    row = await _active(db, person_id)
    await db.execute(update(person).where(person.c.id == person_id).values(deactivated_at=func.now()))
    await ensure_admin_remains(db)
    await revoke_codes(db, person_id)
    sessions = await _end(db, session, (await db.execute(queries.open_sessions(person_id))).all())
    tokens = (await db.execute(queries.open_tokens(person_id))).all()
    links = (await db.execute(queries.open_links(person_id))).all()
    owned = (await db.execute(queries.owned_by_person(person_id))).scalars().all()
    handed = await give_to_admins(db, owned)
    departure = Departure(
        person=PersonRef(id=person_id, name=row.name),
        sessions=sessions,
        tokens=await _end(db, token, tokens),
        links=await _end(db, share, links),
        projects=[project.name for project in handed],
    )
    after = departure.model_dump(mode="json", exclude={"person"})
    left = Event("person.deactivate", "person", person_id, row.name, None, after=after, by_power=True)
    events = [_token_ended(each) for each in tokens] + [_link_ended(each) for each in links]
    await record_all(db, actor, [left, *events, *(_handed(each) for each in handed)])
    return departure


async def reactivate(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Let somebody sign in again, with the memberships and grants they have; nothing happens where they may.

    Raises:
        NotFound: there is nobody of that id.
    """
    await lock_rights(db)
    seen = await get_person(db, actor, person_id)
    if seen.deactivated_at is None:
        return seen
    await db.execute(update(person).where(person.c.id == person_id).values(deactivated_at=None))
    await record(db, actor, Event("person.reactivate", "person", person_id, seen.name, None, by_power=True))
    return await get_person(db, actor, person_id)


async def _active(db: Connection, person_id: uuid.UUID) -> Row[Any]:
    row = (await db.execute(queries.lock_person(person_id))).one_or_none()
    if row is None or row.deactivated_at is not None:
        raise NotFound(noun="active person", ref=str(person_id))
    return row


async def _end(db: Connection, table: Table, rows: Sequence[Row[Any]]) -> int:
    ids = [row.id for row in rows]
    await db.execute(update(table).where(table.c.id.in_(ids)).values(revoked_at=func.now()))
    return len(ids)


def _token_ended(row: Row[Any]) -> Event:
    return Event("token.revoke", "token", row.id, row.name, None, by_power=True)


def _link_ended(row: Row[Any]) -> Event:
    return Event("share.revoke", "share", row.id, row.name, row.project_id, mission_id=row.mission_id, by_power=True)


def _handed(row: Row[Any]) -> Event:
    after: Metadata = {"right": Right.delete.value, "expires_at": None}
    return Event("grant.give", "grant", None, "admins", row.id, after=after, by_power=True)
