"""No project without an owner, in the trash neither.

A lasting owner is somebody active, in a group without an end, which has DELETE on the project without an end. Rights
granted to an address do not count: whether anybody has that address is not for the granter to find out.
"""

import uuid
from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import Row, Select, exists, select

from kleinkram.contract.errors import LastAdmin, LastOwner
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.server.access.groups import ADMINS_ID, own_project
from kleinkram.server.access.rights import lock_rights
from kleinkram.server.db import Connection
from kleinkram.server.tables import access_grant, access_group, membership, person, project


def owned_by_groups(group_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return the ids of the projects that some groups own without an end."""
    lasting = (access_grant.c.level == Right.delete.level) & access_grant.c.expires_at.is_(None)
    return select(access_grant.c.project_id).where(
        lasting, access_grant.c.project_id.is_not(None), access_grant.c.group_id.in_(group_ids)
    )


async def ensure_owner_remains(db: Connection, project_ids: Sequence[uuid.UUID]) -> None:
    """After a change that took rights away, see that none of some projects lost its last lasting owner.

    Raises:
        LastOwner: one did.
    """
    rows = await _unowned(db, project_ids)
    if rows:
        raise LastOwner(projects=[row.name for row in rows])


async def ensure_admin_remains(db: Connection) -> None:
    """After a change that took the power of an admin away, see that somebody active keeps it without an end.

    Raises:
        LastAdmin: nobody does.
    """
    lasting = (membership.c.group_id == ADMINS_ID) & membership.c.expires_at.is_(None)
    joined = select(person.c.id).join_from(membership, person, person.c.id == membership.c.person_id)
    if (await db.execute(joined.where(lasting, person.c.deactivated_at.is_(None)).limit(1))).first() is None:
        raise LastAdmin


async def give_to_admins(db: Connection, project_ids: Sequence[uuid.UUID]) -> Sequence[Row[Any]]:
    """Make the admins owners of those of some projects that nobody owns any more, and return these (`id`, `name`)."""
    rows = await _unowned(db, project_ids)
    for row in rows:
        await own_project(db, project_id=row.id, group_id=ADMINS_ID)
    return rows


async def _unowned(db: Connection, project_ids: Sequence[uuid.UUID]) -> Sequence[Row[Any]]:
    await lock_rights(db)
    owned = (
        exists()
        .where(
            access_grant.c.project_id == project.c.id,
            access_grant.c.level == Right.delete.level,
            access_grant.c.expires_at.is_(None),
            access_group.c.id == access_grant.c.group_id,
            access_group.c.kind != GroupKind.email.value,
            membership.c.group_id == access_grant.c.group_id,
            membership.c.expires_at.is_(None),
            person.c.id == membership.c.person_id,
            person.c.deactivated_at.is_(None),
        )
        .correlate(project)
    )
    stmt = select(project.c.id, project.c.name).where(project.c.id.in_(project_ids), ~owned)
    return (await db.execute(stmt.order_by(project.c.name, project.c.id))).all()
