"""What is asked of people. Functions return selects; they touch no connection."""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, Table, case, delete, exists, func, select, update

from kleinkram.contract.access import Right
from kleinkram.contract.base import Page
from kleinkram.contract.errors import NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.people import Departure, PersonRead, PersonRef
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.groups import ADMINS_ID, make_admin
from kleinkram.server.access.rights import ensure_admin_remains, give_to_admins, lock_rights
from kleinkram.server.access.visible import knows_addresses, visible_people
from kleinkram.server.audit.service import Event, record, record_all
from kleinkram.server.auth.one_time_codes import revoke_codes
from kleinkram.server.db import Connection
from kleinkram.server.filters.patterns import holds_word
from kleinkram.server.paging import Order, PageRequest, fetch_page
from kleinkram.server.tables import access_grant, membership, mission, person, person_email, session, share, token

# By name, then by age.
PEOPLE_ORDER = Order([person.c.name.collate("C"), person.c.id])


def people_seen(actor: Actor) -> Select[Any]:
    """Return the visible people, as `to_person` reads them."""
    is_admin = exists().where(
        membership.c.group_id == ADMINS_ID, membership.c.person_id == person.c.id, unexpired(membership.c.expires_at)
    )
    emails = case((knows_addresses(actor), addresses_of(person.c.id)), else_=None).label("emails")
    return visible_people(actor).add_columns(is_admin.label("is_admin"), emails)


def addresses_of(person_id: ColumnElement[Any]) -> ColumnElement[Any]:
    """Return the verified addresses of each person of a select, as one array."""
    stmt = select(person_email.c.email).where(person_email.c.person_id == person_id)
    verified = stmt.where(person_email.c.verified_at.is_not(None)).order_by(person_email.c.email_key)
    return func.array(verified.correlate_except(person_email).scalar_subquery())


def matching_people(actor: Actor, *, text: str | None, active: bool | None) -> Select[Any]:
    """Return the visible people of whom every word of `text` is in their name, or in an address that one may know."""
    stmt = people_seen(actor)
    for word in (text or "").split():
        address = exists().where(
            person_email.c.person_id == person.c.id,
            person_email.c.verified_at.is_not(None),
            person_email.c.email_key.contains(name_key(word), autoescape=True),
        )
        stmt = stmt.where(holds_word(person.c.name, word) | (knows_addresses(actor) & address))
    if active is not None:
        stmt = stmt.where(person.c.deactivated_at.is_(None) == active)
    return stmt


def to_person(row: Row[Any]) -> PersonRead:
    """Return the person that a row stands for."""
    return PersonRead(
        id=row.id,
        name=row.name,
        emails=row.emails or [],
        is_admin=row.is_admin,
        created_at=row.created_at,
        deactivated_at=row.deactivated_at,
    )


def lock_person(person_id: uuid.UUID) -> Select[Any]:
    """Return the select that keeps others from changing whether somebody is active, and from acting for them anew."""
    return select(person).where(person.c.id == person_id).with_for_update()


def open_tokens(person_id: uuid.UUID) -> Select[Any]:
    """Return the ids and names of somebody's tokens that are not revoked."""
    return select(token.c.id, token.c.name).where(token.c.person_id == person_id, token.c.revoked_at.is_(None))


def open_sessions(person_id: uuid.UUID) -> Select[Any]:
    """Return the ids of somebody's sessions that are not revoked."""
    return select(session.c.id).where(session.c.person_id == person_id, session.c.revoked_at.is_(None))


def open_links(person_id: uuid.UUID) -> Select[Any]:
    """Return the links that somebody made and that are not revoked, with where they lead."""
    stmt = select(share.c.id, share.c.name, share.c.mission_id, mission.c.project_id)
    joined = stmt.join(mission, mission.c.id == share.c.mission_id)
    return joined.where(share.c.created_by_id == person_id, share.c.revoked_at.is_(None))


def owned_by_person(person_id: uuid.UUID) -> Select[Any]:
    """Return the ids of the projects that somebody owns without an end, by whatever group."""
    lasting = (access_grant.c.level == Right.delete.level) & access_grant.c.expires_at.is_(None)
    joined = select(access_grant.c.project_id).join(membership, membership.c.group_id == access_grant.c.group_id)
    theirs = (membership.c.person_id == person_id) & membership.c.expires_at.is_(None)
    return joined.where(lasting, theirs, access_grant.c.project_id.is_not(None)).distinct()


async def list_people(
    db: Connection, actor: Actor, *, text: str | None, active: bool | None, page: PageRequest
) -> Page[PersonRead]:
    """Return a page of the people that `actor` may know of, by name.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    rows = await fetch_page(db, matching_people(actor, text=text, active=active), PEOPLE_ORDER, page)
    return Page(items=[to_person(row) for row in rows.items], next=rows.next, total=rows.total)


async def get_person(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Return somebody.

    Raises:
        NotFound: there is nobody of that id whom `actor` may know of.
    """
    row = (await db.execute(people_seen(actor).where(person.c.id == person_id))).one_or_none()
    if row is None:
        raise NotFound(noun="person", ref=str(person_id))
    return to_person(row)


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
    sessions = await _end(db, session, (await db.execute(open_sessions(person_id))).all())
    tokens = (await db.execute(open_tokens(person_id))).all()
    links = (await db.execute(open_links(person_id))).all()
    owned = (await db.execute(owned_by_person(person_id))).scalars().all()
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
    row = (await db.execute(lock_person(person_id))).one_or_none()
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
