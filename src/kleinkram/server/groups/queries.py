"""Selects on groups and their members; they touch no connection."""

import uuid
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, and_, case, func, null, select

from kleinkram.contract.access import GroupKind, GroupRead, MemberRead, Right
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.visible import may_see_addresses, visible_groups
from kleinkram.server.pagination import Order
from kleinkram.server.tables import access_group, affiliation, affiliation_domain, membership, person, person_email

_creator, _adder, _mine = person.alias("maker"), person.alias("adder"), membership.alias("mine")
GROUP_ORDER = Order([access_group.c.name, access_group.c.id])
MEMBER_ORDER = Order([person.c.name.collate("C"), person.c.id])


def groups_seen(actor: Actor) -> Select[Any]:
    """Return the visible groups for `to_group`."""
    active = (membership.c.group_id == access_group.c.id) & _is_active()
    count = select(func.count()).join_from(membership, person, person.c.id == membership.c.person_id).where(active)
    domains = select(affiliation_domain.c.domain).where(affiliation_domain.c.group_id == access_group.c.id)
    own = and_(
        _mine.c.group_id == access_group.c.id, _mine.c.person_id == actor.person_id, unexpired(_mine.c.expires_at)
    )
    return (
        visible_groups(actor)
        .add_columns(
            count.correlate(access_group).scalar_subquery().label("member_count"),
            func.array(domains.order_by(affiliation_domain.c.domain).scalar_subquery()).label("domains"),
            affiliation.c.default_level,
            _creator.c.name.label("creator_name"),
            _mine.c.person_id.label("my_id"),
            _mine.c.is_editor,
            _mine.c.expires_at,
        )
        .outerjoin(affiliation, affiliation.c.group_id == access_group.c.id)
        .outerjoin(_creator, _creator.c.id == access_group.c.created_by_id)
        .outerjoin(_mine, own)
    )


def _is_active() -> ColumnElement[bool]:
    return unexpired(membership.c.expires_at) & person.c.deactivated_at.is_(None)


def to_group(row: Row[Any]) -> GroupRead:
    """Return the group in a row of `groups_seen`."""
    return GroupRead(
        id=row.id,
        name=row.name,
        kind=GroupKind(row.kind),
        member_count=row.member_count,
        is_member=row.my_id is not None,
        is_editor=bool(row.is_editor),
        expires_at=row.expires_at,
        domains=row.domains,
        default_right=Right.of_level(row.default_level) if row.default_level else None,
        created_at=row.created_at,
        created_by=PersonRef(id=row.created_by_id, name=row.creator_name) if row.created_by_id else None,
    )


def members_of(actor: Actor, group_id: uuid.UUID, *, for_editor: bool) -> Select[Any]:
    """Return the members of a group for `to_member`; only editors see past members, and addresses they may know."""
    emails = select(person_email.c.email).where(
        person_email.c.person_id == person.c.id, person_email.c.verified_at.is_not(None)
    )
    addresses = func.array(emails.order_by(person_email.c.email_key).correlate(person).scalar_subquery())
    stmt = (
        select(
            person.c.id,
            person.c.name,
            (case((may_see_addresses(actor), addresses), else_=null()) if for_editor else null()).label("emails"),
            _is_active().label("is_active"),
            membership.c.is_editor,
            membership.c.expires_at,
            membership.c.created_at,
            membership.c.added_by_id,
            _adder.c.name.label("adder_name"),
        )
        .join_from(membership, person, person.c.id == membership.c.person_id)
        .outerjoin(_adder, _adder.c.id == membership.c.added_by_id)
        .where(membership.c.group_id == group_id)
    )
    return stmt if for_editor else stmt.where(_is_active())


def to_member(row: Row[Any]) -> MemberRead:
    """Return the member in a row of `members_of`."""
    return MemberRead(
        person=PersonRef(id=row.id, name=row.name),
        emails=row.emails or [],
        is_editor=row.is_editor,
        is_active=row.is_active,
        expires_at=row.expires_at,
        added_at=row.created_at,
        added_by=PersonRef(id=row.added_by_id, name=row.adder_name) if row.added_by_id else None,
    )
