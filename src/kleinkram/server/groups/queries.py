"""What is asked of groups. Functions return selects; they touch no connection."""

import uuid
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, and_, case, func, null, select

from kleinkram.contract.groups import GroupRead, MemberRead
from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.visible import knows_addresses, visible_groups
from kleinkram.server.filters.patterns import matches_key
from kleinkram.server.paging import Order
from kleinkram.server.tables import (
    access_grant,
    access_group,
    affiliation,
    affiliation_domain,
    membership,
    mission,
    person,
    person_email,
)

_maker, _adder = person.alias("maker"), person.alias("adder")
_mine = membership.alias("mine")
GROUP_ORDER = Order([access_group.c.name, access_group.c.id])
MEMBER_ORDER = Order([person.c.name.collate("C"), person.c.id])


def groups_seen(actor: Actor) -> Select[Any]:
    """Return the visible groups, as `to_group` reads them."""
    active = (membership.c.group_id == access_group.c.id) & is_active()
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
            _maker.c.name.label("maker_name"),
            _mine.c.person_id.label("my_id"),
            _mine.c.is_editor,
            _mine.c.expires_at,
        )
        .outerjoin(affiliation, affiliation.c.group_id == access_group.c.id)
        .outerjoin(_maker, _maker.c.id == access_group.c.created_by_id)
        .outerjoin(_mine, own)
    )


def matching_groups(actor: Actor, *, name: str | None) -> Select[Any]:
    """Return the visible groups whose name matches a glob."""
    stmt = groups_seen(actor)
    return stmt if name is None else stmt.where(matches_key(access_group.c.name_key, name))


def is_active() -> ColumnElement[bool]:
    """Say of a membership joined with its person that neither their time has ended nor did they leave."""
    return unexpired(membership.c.expires_at) & person.c.deactivated_at.is_(None)


def to_group(row: Row[Any]) -> GroupRead:
    """Return the group that a row stands for."""
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
        created_by=PersonRef(id=row.created_by_id, name=row.maker_name) if row.created_by_id else None,
    )


def members_of(actor: Actor, group_id: uuid.UUID, *, for_editor: bool) -> Select[Any]:
    """Return the people in a group, as `to_member` reads them; addresses and past members only for its editors.

    Of addresses they see those that they may know at all (`knows_addresses`).
    """
    emails = select(person_email.c.email).where(
        person_email.c.person_id == person.c.id, person_email.c.verified_at.is_not(None)
    )
    found = func.array(emails.order_by(person_email.c.email_key).correlate(person).scalar_subquery())
    stmt = (
        select(
            person.c.id,
            person.c.name,
            (case((knows_addresses(actor), found), else_=null()) if for_editor else null()).label("emails"),
            is_active().label("is_active"),
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
    return stmt if for_editor else stmt.where(is_active())


def to_member(row: Row[Any]) -> MemberRead:
    """Return the member that a row stands for."""
    return MemberRead(
        person=PersonRef(id=row.id, name=row.name),
        emails=row.emails or [],
        is_editor=row.is_editor,
        is_active=row.is_active,
        expires_at=row.expires_at,
        added_at=row.created_at,
        added_by=PersonRef(id=row.added_by_id, name=row.adder_name) if row.added_by_id else None,
    )


def granted_to(group_id: uuid.UUID) -> Select[Any]:
    """Return what was granted to a group, with the projects."""
    project_id = func.coalesce(access_grant.c.project_id, mission.c.project_id).label("on_project_id")
    joined = select(access_grant, project_id).outerjoin(mission, mission.c.id == access_grant.c.mission_id)
    return joined.where(access_grant.c.group_id == group_id)
