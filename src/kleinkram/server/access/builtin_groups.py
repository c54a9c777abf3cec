"""Groups that the server makes: one per person, one per e-mail address, and the admins. Adds new people to them."""

import uuid

from sqlalchemy import func, insert, select
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.access import GroupKind, Right
from kleinkram.contract.names import name_key
from kleinkram.contract.people import email_domain, email_key
from kleinkram.server.db import Connection
from kleinkram.server.tables import access_grant, access_group, affiliation_domain, membership, person, person_email


async def join_email_groups(db: Connection, person_id: uuid.UUID, email: str) -> None:
    """Add a person to the groups that follow from an address that was just verified."""
    await _join(db, await email_group(db, email), person_id)
    domains = select(affiliation_domain.c.group_id).where(affiliation_domain.c.domain == email_domain(email))
    for group_id in (await db.execute(domains.order_by(affiliation_domain.c.group_id))).scalars().all():
        await _join(db, group_id, person_id)


async def email_group(db: Connection, email: str) -> uuid.UUID:
    """Return the group of an address, created if necessary; the person who verified the address is in it."""
    key = email_key(email)
    new_group = {"id": uuid.uuid4(), "kind": GroupKind.email.value, "name": key, "name_key": key}
    # Waits for a concurrent creation, so that neither the grant nor the member is missed.
    await db.execute(upsert(access_group).values(new_group).on_conflict_do_nothing())
    is_of_address = (access_group.c.kind == GroupKind.email.value) & (access_group.c.name_key == key)
    group_id: uuid.UUID = (await db.execute(select(access_group.c.id).where(is_of_address))).scalar_one()
    is_verified = (person_email.c.email_key == key) & person_email.c.verified_at.is_not(None)
    person_id = (await db.execute(select(person_email.c.person_id).where(is_verified))).scalar_one_or_none()
    if person_id is not None:
        await _join(db, group_id, person_id)
    return group_id


async def _join(db: Connection, group_id: uuid.UUID, person_id: uuid.UUID) -> None:
    await db.execute(upsert(membership).values(group_id=group_id, person_id=person_id).on_conflict_do_nothing())


# Fixed; created with the schema.
ADMINS_ID = uuid.UUID("61646d69-6e73-4000-8000-000000000001")
# The local owner of `klein up`.
OWNER_ID = uuid.UUID("6f776e65-7200-4000-8000-000000000001")
OWNER_TOKEN_NAME = "local owner"  # noqa: S105  the token's label, not its secret


async def add_person(db: Connection, *, name: str, person_id: uuid.UUID | None = None) -> uuid.UUID:
    """Create a person with their own group, unless the id exists, and return the id."""
    new_id = person_id or uuid.uuid4()
    row = upsert(person).values(id=new_id, name=name).on_conflict_do_nothing()
    if (await db.execute(row.returning(person.c.id))).first() is None:
        return new_id
    group_id = uuid.uuid4()
    group = {"id": group_id, "kind": GroupKind.person.value, "name": name, "name_key": name_key(name)}
    await db.execute(insert(access_group).values(**group, person_id=new_id))
    await db.execute(insert(membership).values(group_id=group_id, person_id=new_id))
    return new_id


async def own_group(db: Connection, person_id: uuid.UUID | None) -> uuid.UUID:
    """Return the own group of a person."""
    stmt = select(access_group.c.id).where(access_group.c.person_id == person_id)
    group_id: uuid.UUID = (await db.execute(stmt)).scalar_one()
    return group_id


async def add_verified_address(db: Connection, person_id: uuid.UUID, email: str, *, by: str) -> bool:
    """Add a verified address to a person and their groups; returns False if it belongs to another person."""
    values = {"email_key": email_key(email), "email": email, "person_id": person_id}
    row = upsert(person_email).values(**values, verified_at=func.now(), verified_by=by)
    row = row.on_conflict_do_update(
        index_elements=["email_key"],
        set_={"email": email, "verified_at": func.now(), "verified_by": by},
        where=person_email.c.person_id == person_id,
    )
    if (await db.execute(row.returning(person_email.c.email_key))).first() is None:
        return False
    await join_email_groups(db, person_id, email)
    return True


async def make_admin(db: Connection, person_id: uuid.UUID) -> None:
    """Make a person a permanent admin."""
    row = upsert(membership).values(group_id=ADMINS_ID, person_id=person_id)
    await db.execute(row.on_conflict_do_update(index_elements=["group_id", "person_id"], set_={"expires_at": None}))


async def own_project(db: Connection, *, project_id: uuid.UUID, group_id: uuid.UUID) -> None:
    """Make a group the owner of a project: DELETE without an end."""
    row = upsert(access_grant).values(
        id=uuid.uuid4(), group_id=group_id, project_id=project_id, level=Right.delete.level
    )
    await db.execute(
        row.on_conflict_do_update(
            index_elements=["project_id", "group_id"], set_={"level": Right.delete.level, "expires_at": None}
        )
    )
