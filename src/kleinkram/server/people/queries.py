"""What is asked of people. Functions return selects; they touch no connection."""

import uuid
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, case, exists, func, select

from kleinkram.contract.names import name_key
from kleinkram.contract.people import PersonRead
from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.groups import ADMINS_ID
from kleinkram.server.access.visible import knows_addresses, visible_people
from kleinkram.server.filters.patterns import holds_word
from kleinkram.server.paging import Order
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
