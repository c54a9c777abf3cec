"""The groups that follow from an address: its own, and those that are affiliated with its exact domain.

A right that is granted to an address is granted to the address's own group, whether or not somebody has it yet.
"""

import uuid

from sqlalchemy import select
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.emails import email_domain, email_key
from kleinkram.contract.rights import GroupKind
from kleinkram.server.db import Connection
from kleinkram.server.tables import access_group, affiliation_domain, membership, person_email


async def join_email_groups(db: Connection, person_id: uuid.UUID, email: str) -> None:
    """Put somebody into the groups that follow from an address which was just verified to be theirs."""
    await _join(db, await email_group(db, email), person_id)
    domains = select(affiliation_domain.c.group_id).where(affiliation_domain.c.domain == email_domain(email))
    for group_id in (await db.execute(domains.order_by(affiliation_domain.c.group_id))).scalars().all():
        await _join(db, group_id, person_id)


async def email_group(db: Connection, email: str) -> uuid.UUID:
    """Return the group of an address, made where there is none; whoever has verified the address is in it."""
    key = email_key(email)
    made = {"id": uuid.uuid4(), "kind": GroupKind.email.value, "name": key, "name_key": key}
    # Whoever makes it at the same time is waited for, so that neither the grant nor the member is missed.
    await db.execute(upsert(access_group).values(made).on_conflict_do_nothing())
    same = (access_group.c.kind == GroupKind.email.value) & (access_group.c.name_key == key)
    group_id: uuid.UUID = (await db.execute(select(access_group.c.id).where(same))).scalar_one()
    verified = (person_email.c.email_key == key) & person_email.c.verified_at.is_not(None)
    person_id = (await db.execute(select(person_email.c.person_id).where(verified))).scalar_one_or_none()
    if person_id is not None:
        await _join(db, group_id, person_id)
    return group_id


async def _join(db: Connection, group_id: uuid.UUID, person_id: uuid.UUID) -> None:
    await db.execute(upsert(membership).values(group_id=group_id, person_id=person_id).on_conflict_do_nothing())
