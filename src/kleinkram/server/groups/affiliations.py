"""Making the affiliation groups what the settings say: when a server starts, however many processes start at once.

A domain counts exactly: somebody of `a.lab.example` is not of `lab.example`. A group that the settings name no longer
loses its members and keeps its grants, so that a slip in the settings loses nothing for good.
"""

import uuid
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, delete, exists, func, insert, select, text, update
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.server.access.ownership import give_to_admins, owned_by_groups
from kleinkram.server.access.rights import lock_rights
from kleinkram.server.audit.service import Event, record_all
from kleinkram.server.db import Connection
from kleinkram.server.settings import Affiliation
from kleinkram.server.tables import access_group, affiliation, affiliation_domain, membership, person, person_email


class AffiliationUnusable(Exception):
    """An affiliation in the settings has the name of a group that people made."""


async def ensure_affiliations(db: Connection, wanted: Sequence[Affiliation]) -> None:
    """Make the affiliation groups exist, with exactly the members that the settings and the verified addresses say.

    Projects that are left without an owner by that go to the admins.

    Raises:
        AffiliationUnusable: a name is taken by a group that people made.
    """
    await lock_rights(db)
    # Whoever verifies an address meanwhile is waited for, or reads the new domains.
    await db.execute(text("LOCK TABLE person_email IN SHARE ROW EXCLUSIVE MODE"))
    ids = [await _ensure_group(db, each) for each in wanted]
    await db.execute(delete(affiliation).where(affiliation.c.group_id.not_in(ids)))
    groups = await _all_groups(db)
    owned = (await db.execute(owned_by_groups(groups))).scalars().all()
    left = (await db.execute(_no_longer())).all()
    joined = (await db.execute(_newly())).all()
    for row in left:
        await db.execute(
            delete(membership).where(membership.c.group_id == row.group_id, membership.c.person_id == row.person_id)
        )
    if joined:
        values = [{"group_id": row.group_id, "person_id": row.person_id} for row in joined]
        await db.execute(insert(membership), values)
    handed = await give_to_admins(db, owned)
    await record_all(db, None, [*(_told(row, True) for row in left), *(_told(row, False) for row in joined)])
    await record_all(db, None, [_given(row) for row in handed])


async def _ensure_group(db: Connection, wanted: Affiliation) -> uuid.UUID:
    key, kind = name_key(wanted.name), GroupKind.affiliation.value
    same = (access_group.c.name_key == key) & (access_group.c.kind == kind)
    group_id: uuid.UUID | None = (await db.execute(select(access_group.c.id).where(same))).scalar_one_or_none()
    if group_id is None:
        group_id = uuid.uuid4()
        values = {"id": group_id, "kind": kind, "name": wanted.name, "name_key": key}
        try:
            await db.execute(insert(access_group).values(values))
        except IntegrityError as error:
            raise AffiliationUnusable(
                f"KLEINKRAM_AFFILIATIONS: there is a group {wanted.name!r} that people made; rename one of the two"
            ) from error
        await record_all(db, None, [Event("group.create", "group", group_id, wanted.name, None)])
    await db.execute(update(access_group).where(access_group.c.id == group_id).values(name=wanted.name))
    level = {"default_level": wanted.default_right.level if wanted.default_right else None}
    said = upsert(affiliation).values(group_id=group_id, **level)
    await db.execute(said.on_conflict_do_update(index_elements=["group_id"], set_=level))
    of_group = affiliation_domain.c.group_id == group_id
    await db.execute(delete(affiliation_domain).where(of_group, affiliation_domain.c.domain.not_in(wanted.domains)))
    domains = [{"group_id": group_id, "domain": domain} for domain in wanted.domains]
    await db.execute(upsert(affiliation_domain).values(domains).on_conflict_do_nothing())
    return group_id


async def _all_groups(db: Connection) -> Collection[uuid.UUID]:
    stmt = select(access_group.c.id).where(access_group.c.kind == GroupKind.affiliation.value)
    return (await db.execute(stmt)).scalars().all()


def _domain() -> ColumnElement[str]:
    return func.split_part(person_email.c.email_key, "@", -1)


def _no_longer() -> Select[Any]:
    """Return the memberships of affiliation groups that no verified address gives any more."""
    given = exists().where(
        affiliation_domain.c.group_id == membership.c.group_id,
        person_email.c.person_id == membership.c.person_id,
        person_email.c.verified_at.is_not(None),
        _domain() == affiliation_domain.c.domain,
    )
    stmt = select(membership.c.group_id, membership.c.person_id, access_group.c.name, person.c.name.label("who"))
    joined = stmt.join_from(membership, access_group, access_group.c.id == membership.c.group_id)
    joined = joined.join(person, person.c.id == membership.c.person_id)
    return joined.where(access_group.c.kind == GroupKind.affiliation.value, ~given.correlate(membership))


def _newly() -> Select[Any]:
    """Return the memberships that verified addresses give and that are not there yet."""
    there = exists().where(
        membership.c.group_id == affiliation_domain.c.group_id, membership.c.person_id == person_email.c.person_id
    )
    stmt = select(access_group.c.id.label("group_id"), person.c.id.label("person_id"))
    stmt = stmt.add_columns(access_group.c.name, person.c.name.label("who")).distinct()
    joined = stmt.join_from(affiliation_domain, access_group, access_group.c.id == affiliation_domain.c.group_id)
    joined = joined.join(person_email, _domain() == affiliation_domain.c.domain)
    joined = joined.join(person, person.c.id == person_email.c.person_id)
    correlated = there.correlate(affiliation_domain, person_email)
    return joined.where(person_email.c.verified_at.is_not(None), ~correlated)


def _told(row: Row[Any], removed: bool) -> Event:
    after: Metadata = {"person": row.who, "removed": True} if removed else {"person": row.who}
    return Event("group.member", "group", row.group_id, row.name, None, after=after)


def _given(row: Row[Any]) -> Event:
    after: Metadata = {"right": Right.delete.value, "expires_at": None}
    return Event("grant.give", "grant", None, "admins", row.id, after=after)
