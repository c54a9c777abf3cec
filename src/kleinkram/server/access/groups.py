"""The groups that every account needs: its own, and that of the admins. The rest of groups is a feature of its own."""

import uuid

from sqlalchemy import func, insert, select
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.emails import email_key
from kleinkram.contract.names import name_key
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.server.access.email_groups import join_email_groups
from kleinkram.server.db import Connection
from kleinkram.server.tables import access_grant, access_group, membership, person, person_email

# Fixed, and made with the schema.
ADMINS_ID = uuid.UUID("61646d69-6e73-4000-8000-000000000001")
# The local owner of `klein up`. Fixed, so that every start finds the same person without a search by name.
OWNER_ID = uuid.UUID("6f776e65-7200-4000-8000-000000000001")
OWNER_TOKEN_NAME = "local owner"  # noqa: S105  the token's label, not its secret


async def add_person(db: Connection, *, name: str, person_id: uuid.UUID | None = None) -> uuid.UUID:
    """Make a person with a group of their own, and return their id. Nothing happens where that id is there already."""
    made = person_id or uuid.uuid4()
    added = await db.execute(upsert(person).values(id=made, name=name).on_conflict_do_nothing().returning(person.c.id))
    if added.first() is None:
        return made
    group_id = uuid.uuid4()
    own = {"id": group_id, "kind": GroupKind.person.value, "name": name, "name_key": name_key(name), "person_id": made}
    await db.execute(insert(access_group).values(own))
    await db.execute(insert(membership).values(group_id=group_id, person_id=made))
    return made


async def own_group(db: Connection, person_id: uuid.UUID | None) -> uuid.UUID:
    """Return the group that is one person's own."""
    found = select(access_group.c.id).where(access_group.c.person_id == person_id)
    group_id: uuid.UUID = (await db.execute(found)).scalar_one()
    return group_id


async def prove_address(db: Connection, person_id: uuid.UUID, email: str, *, by: str) -> bool:
    """Note that an address is somebody's, by whose word, and put them into the groups that follow from it.

    Returns whether it is theirs now: an address that is another person's stays that person's.
    """
    values = {"email_key": email_key(email), "email": email, "person_id": person_id}
    row = upsert(person_email).values(**values, verified_at=func.now(), verified_by=by)
    proven = row.on_conflict_do_update(
        index_elements=["email_key"],
        set_={"email": email, "verified_at": func.now(), "verified_by": by},
        where=person_email.c.person_id == person_id,
    )
    if (await db.execute(proven.returning(person_email.c.email_key))).first() is None:
        return False
    await join_email_groups(db, person_id, email)
    return True


async def make_admin(db: Connection, person_id: uuid.UUID) -> None:
    """Put somebody into the group of admins for good; nothing happens where they are in it for good."""
    row = upsert(membership).values(group_id=ADMINS_ID, person_id=person_id)
    await db.execute(row.on_conflict_do_update(index_elements=["group_id", "person_id"], set_={"expires_at": None}))


async def own_project(db: Connection, *, project_id: uuid.UUID, group_id: uuid.UUID) -> None:
    """Make a group the owner of a project: DELETE, without an end."""
    row = upsert(access_grant).values(
        id=uuid.uuid4(), group_id=group_id, project_id=project_id, level=Right.delete.level
    )
    await db.execute(
        row.on_conflict_do_update(
            index_elements=["project_id", "group_id"], set_={"level": Right.delete.level, "expires_at": None}
        )
    )
