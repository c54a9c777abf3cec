"""Synchronizes the affiliation groups with the settings, when a server process starts.

Only the exact domain counts: a person of `a.lab.example` is not in `lab.example`. A group that left the settings loses
its members and keeps its grants, so that a mistake in the settings loses nothing permanently.
"""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Select, delete, exists, func, insert, select, text, update
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.access import GroupKind, Right
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.server.access.rights import give_to_admins, lock_rights, owned_by_groups
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection
from kleinkram.server.settings import Affiliation
from kleinkram.server.tables import access_group, affiliation, affiliation_domain, membership, person, person_email

_DOMAIN = func.split_part(person_email.c.email_key, "@", -1)


class AffiliationUnusable(Exception):
    """An affiliation in the settings has the name of a group that people created."""


async def ensure_affiliations(db: Connection, affiliations: Sequence[Affiliation]) -> None:
    """Make the affiliation groups and their members match the settings and the verified addresses.

    Projects that lose their last owner go to the admins. Raises AffiliationUnusable.
    """
    await lock_rights(db)
    # Concurrent verifications of addresses wait, or see the new domains.
    await db.execute(text("LOCK TABLE person_email IN SHARE ROW EXCLUSIVE MODE"))
    ids = [await _ensure_group(db, configured) for configured in affiliations]
    await db.execute(delete(affiliation).where(affiliation.c.group_id.not_in(ids)))
    groups = select(access_group.c.id).where(access_group.c.kind == GroupKind.affiliation.value)
    owned = (await db.execute(owned_by_groups((await db.execute(groups)).scalars().all()))).scalars().all()
    left = (await db.execute(_outdated_members())).all()
    joined = (await db.execute(_missing_members())).all()
    for row in left:
        same = (membership.c.group_id == row.group_id) & (membership.c.person_id == row.person_id)
        await db.execute(delete(membership).where(same))
    if joined:
        values = [{"group_id": row.group_id, "person_id": row.person_id} for row in joined]
        await db.execute(insert(membership), values)
    events: list[Event] = []
    for row in (*left, *joined):
        after: Metadata = {"person": row.who, **({"removed": True} if row in left else {})}
        events.append(Event("group.member", "group", row.group_id, row.name, after=after))
    owner_right: Metadata = {"right": Right.delete.value, "expires_at": None}
    inherited = await give_to_admins(db, owned)
    events += [Event("grant.create", "grant", None, "admins", project.id, after=owner_right) for project in inherited]
    await audit(db, None, *events)


async def _ensure_group(db: Connection, configured: Affiliation) -> uuid.UUID:
    key, kind = name_key(configured.name), GroupKind.affiliation.value
    is_same = (access_group.c.name_key == key) & (access_group.c.kind == kind)
    group_id: uuid.UUID | None = (await db.execute(select(access_group.c.id).where(is_same))).scalar_one_or_none()
    if group_id is None:
        group_id = uuid.uuid4()
        try:
            await db.execute(insert(access_group).values(id=group_id, kind=kind, name=configured.name, name_key=key))
        except IntegrityError as error:
            raise AffiliationUnusable(
                f"KLEINKRAM_AFFILIATIONS: there is a group {configured.name!r} that people made; rename one of the two"
            ) from error
        await audit(db, None, Event("group.create", "group", group_id, configured.name))
    await db.execute(update(access_group).where(access_group.c.id == group_id).values(name=configured.name))
    level = {"default_level": configured.default_right.level if configured.default_right else None}
    row = upsert(affiliation).values(group_id=group_id, **level)
    await db.execute(row.on_conflict_do_update(index_elements=["group_id"], set_=level))
    of_group = affiliation_domain.c.group_id == group_id
    await db.execute(delete(affiliation_domain).where(of_group, affiliation_domain.c.domain.not_in(configured.domains)))
    domains = [{"group_id": group_id, "domain": domain} for domain in configured.domains]
    await db.execute(upsert(affiliation_domain).values(domains).on_conflict_do_nothing())
    return group_id


def _outdated_members() -> Select[Any]:
    """Return the memberships of affiliation groups that no verified address supports any more."""
    is_supported = exists().where(
        affiliation_domain.c.group_id == membership.c.group_id,
        person_email.c.person_id == membership.c.person_id,
        person_email.c.verified_at.is_not(None),
        affiliation_domain.c.domain == _DOMAIN,
    )
    stmt = select(membership.c.group_id, membership.c.person_id, access_group.c.name, person.c.name.label("who"))
    joined = stmt.join_from(membership, access_group, access_group.c.id == membership.c.group_id)
    joined = joined.join(person, person.c.id == membership.c.person_id)
    return joined.where(access_group.c.kind == GroupKind.affiliation.value, ~is_supported.correlate(membership))


def _missing_members() -> Select[Any]:
    """Return the memberships that verified addresses support and that do not exist yet."""
    is_member = exists().where(
        membership.c.group_id == affiliation_domain.c.group_id, membership.c.person_id == person_email.c.person_id
    )
    stmt = select(access_group.c.id.label("group_id"), person.c.id.label("person_id"))
    stmt = stmt.add_columns(access_group.c.name, person.c.name.label("who")).distinct()
    joined = stmt.join_from(affiliation_domain, access_group, access_group.c.id == affiliation_domain.c.group_id)
    joined = joined.join(person_email, affiliation_domain.c.domain == _DOMAIN)
    joined = joined.join(person, person.c.id == person_email.c.person_id)
    correlated = is_member.correlate(affiliation_domain, person_email)
    return joined.where(person_email.c.verified_at.is_not(None), ~correlated)
