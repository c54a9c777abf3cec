"""People: lists, admin rights, deactivation. Changes that remove admin rights or accounts begin with `lock_rights`.

Deactivated people keep their name in the audit log, and their memberships and grants in case they are reactivated;
`erasure.py` removes these. Their sessions, tokens, one-time codes and share links end permanently.
"""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row, Select, Table, case, delete, exists, func, select, update

from kleinkram.contract.access import Right
from kleinkram.contract.base import Page
from kleinkram.contract.errors import NotFound, PersonErased
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.people import Departure, PersonRead, PersonRef
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.builtin_groups import ADMINS_ID, make_admin
from kleinkram.server.access.rights import ensure_admin_remains, give_to_admins, lock_rights
from kleinkram.server.access.visible import may_see_addresses, visible_people
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.auth.one_time_codes import revoke_codes
from kleinkram.server.db import ESCAPE, Connection, containing
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.tables import access_grant, membership, mission, person, person_email, session, share, token

_PEOPLE_ORDER = Order([person.c.name.collate("C"), person.c.id])


async def list_people(
    db: Connection, actor: Actor, *, text: str | None, active: bool | None, page: PageRequest
) -> Page[PersonRead]:
    """Return a page of the visible people with every word of `text` in their name or an address the actor may know.

    Raises InvalidCursor.
    """
    stmt = _people_seen(actor)
    for word in (text or "").split():
        has_address = exists().where(
            person_email.c.person_id == person.c.id,
            person_email.c.verified_at.is_not(None),
            person_email.c.email_key.contains(name_key(word), autoescape=True),
        )
        in_name = person.c.name.ilike(containing(word), escape=ESCAPE)
        stmt = stmt.where(in_name | (may_see_addresses(actor) & has_address))
    if active is not None:
        stmt = stmt.where(person.c.deactivated_at.is_(None) == active)
    return await read_page(db, stmt, _PEOPLE_ORDER, page, _to_person)


async def get_person(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Return a visible person. Raises NotFound."""
    row = (await db.execute(_people_seen(actor).where(person.c.id == person_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="person", ref=str(person_id))
    return _to_person(row)


async def appoint_admin(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Make an active person a permanent admin. Raises NotFound."""
    await lock_rights(db)
    name = await _lock_active(db, person_id)
    is_own = (membership.c.group_id == ADMINS_ID) & (membership.c.person_id == person_id)
    old_membership = (await db.execute(select(membership.c.expires_at).where(is_own))).one_or_none()
    if old_membership is None or old_membership.expires_at is not None:
        await audit(db, actor, Event("person.make_admin", "person", person_id, name, needs_admin=True))
        await make_admin(db, person_id)
    return await get_person(db, actor, person_id)


async def dismiss_admin(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Remove a person from the admins, if they are one. Raises NotFound or LastAdmin."""
    await lock_rights(db)
    target = await get_person(db, actor, person_id)
    is_own = (membership.c.group_id == ADMINS_ID) & (membership.c.person_id == person_id)
    if (await db.execute(select(membership.c.group_id).where(is_own))).first() is not None:
        await audit(db, actor, Event("person.unmake_admin", "person", person_id, target.name, needs_admin=True))
        await db.execute(delete(membership).where(is_own))
        await ensure_admin_remains(db)
        target = target.model_copy(update={"is_admin": False})
    return target


async def deactivate(db: Connection, actor: Actor, person_id: uuid.UUID) -> Departure:
    """End a person's sessions, tokens and links; projects that only they owned go to the admins.

    Raises NotFound or LastAdmin.
    """
    await lock_rights(db)
    departure, events = await end_access(db, person_id, await _lock_active(db, person_id))
    after = departure.model_dump(mode="json", exclude={"person"})
    deactivated = Event("person.deactivate", "person", person_id, departure.person.name, after=after, needs_admin=True)
    await audit(db, actor, deactivated, *events)
    return departure


async def end_access(db: Connection, person_id: uuid.UUID, name: str) -> tuple[Departure, list[Event]]:
    """Deactivate a locked person and return what ended, with the events of that. Raises LastAdmin."""
    ended_at = func.coalesce(person.c.deactivated_at, func.now())
    await db.execute(update(person).where(person.c.id == person_id).values(deactivated_at=ended_at))
    await ensure_admin_remains(db)
    await revoke_codes(db, person_id)
    open_sessions = select(session.c.id).where(session.c.person_id == person_id, session.c.revoked_at.is_(None))
    open_tokens = select(token.c.id, token.c.name).where(token.c.person_id == person_id, token.c.revoked_at.is_(None))
    links = select(share.c.id, share.c.name, share.c.mission_id, mission.c.project_id)
    open_links = links.join(mission, mission.c.id == share.c.mission_id).where(
        share.c.created_by_id == person_id, share.c.revoked_at.is_(None)
    )
    sessions = await _end(db, session, open_sessions)
    tokens = await _end(db, token, open_tokens)
    shares = await _end(db, share, open_links)
    inherited = await give_to_admins(db, (await db.execute(_owned_projects(person_id))).scalars().all())
    departure = Departure(
        person=PersonRef(id=person_id, name=name),
        sessions=len(sessions),
        tokens=len(tokens),
        links=len(shares),
        projects=[project.name for project in inherited],
    )
    owner_right: Metadata = {"right": Right.delete.value, "expires_at": None}
    events = [Event("token.revoke", "token", row.id, row.name, needs_admin=True) for row in tokens]
    events += [
        Event("share.revoke", "share", row.id, row.name, row.project_id, mission_id=row.mission_id, needs_admin=True)
        for row in shares
    ]
    events += [
        Event("grant.create", "grant", None, "admins", project.id, after=owner_right, needs_admin=True)
        for project in inherited
    ]
    return departure, events


async def reactivate(db: Connection, actor: Actor, person_id: uuid.UUID) -> PersonRead:
    """Let a deactivated person sign in again, with their memberships and grants. Raises NotFound or PersonErased."""
    await lock_rights(db)
    target = await get_person(db, actor, person_id)
    if target.erased_at is not None:
        raise PersonErased(name=target.name)
    if target.deactivated_at is None:
        return target
    await db.execute(update(person).where(person.c.id == person_id).values(deactivated_at=None))
    await audit(db, actor, Event("person.reactivate", "person", person_id, target.name, needs_admin=True))
    return await get_person(db, actor, person_id)


def _people_seen(actor: Actor) -> Select[Any]:
    is_admin = exists().where(
        membership.c.group_id == ADMINS_ID, membership.c.person_id == person.c.id, unexpired(membership.c.expires_at)
    )
    addresses = select(person_email.c.email).where(
        person_email.c.person_id == person.c.id, person_email.c.verified_at.is_not(None)
    )
    verified = addresses.order_by(person_email.c.email_key).correlate_except(person_email).scalar_subquery()
    emails = case((may_see_addresses(actor), func.array(verified)), else_=None).label("emails")
    return visible_people(actor).add_columns(is_admin.label("is_admin"), emails)


def _to_person(row: Row[Any]) -> PersonRead:
    return PersonRead(
        id=row.id,
        name=row.name,
        emails=row.emails or [],
        is_admin=row.is_admin,
        created_at=row.created_at,
        deactivated_at=row.deactivated_at,
        erased_at=row.erased_at,
    )


def _owned_projects(person_id: uuid.UUID) -> Select[tuple[uuid.UUID]]:
    """Return the ids of the projects that a person owns permanently, by any group."""
    is_permanent = (access_grant.c.level == Right.delete.level) & access_grant.c.expires_at.is_(None)
    projects = select(access_grant.c.project_id).join(membership, membership.c.group_id == access_grant.c.group_id)
    is_member = (membership.c.person_id == person_id) & membership.c.expires_at.is_(None)
    return projects.where(is_permanent, is_member, access_grant.c.project_id.is_not(None)).distinct()


async def _lock_active(db: Connection, person_id: uuid.UUID) -> str:
    """Lock an active person, so that nothing is created for them concurrently, and return their name."""
    row = (await db.execute(select(person).where(person.c.id == person_id).with_for_update())).one_or_none()
    if row is None or row.deactivated_at is not None:
        raise NotFound(resource_type="active person", ref=str(person_id))
    return str(row.name)


async def _end(db: Connection, table: Table, stmt: Select[Any]) -> Sequence[Row[Any]]:
    """Revoke the credentials that a select returns, and return its rows."""
    rows = (await db.execute(stmt)).all()
    await db.execute(update(table).where(table.c.id.in_([row.id for row in rows])).values(revoked_at=func.now()))
    return rows
