"""Who may make projects and groups, which is a setting, and what a new project gives to whom."""

import uuid

from sqlalchemy import exists, insert, select

from kleinkram.contract.errors import Forbidden
from kleinkram.contract.rights import GroupKind, Right
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.groups import own_group, own_project
from kleinkram.server.access.ownership import ensure_owner_remains
from kleinkram.server.access.rights import lock_rights
from kleinkram.server.db import Connection
from kleinkram.server.settings import Creators
from kleinkram.server.tables import access_grant, access_group, affiliation, affiliation_domain, membership


async def require_creator(db: Connection, actor: Actor, creators: Creators, *, noun: str) -> bool:
    """See that `actor` may make a project or a group, and return whether that took the power of an admin.

    Where there are no affiliations, everybody counts as affiliated.

    Raises:
        Forbidden: the setting lets others, or what they came with is limited to what is there.
    """
    if actor.limits is not None:
        raise Forbidden(noun="server", operation=f"create a {noun}", needs="a token without limits")
    if creators == "everybody" or (creators == "affiliated" and await _is_affiliated(db, actor)):
        return False
    if actor.is_admin:
        return True
    needs = "admin rights" if creators == "admins" else "an affiliation with the lab"
    raise Forbidden(noun="server", operation=f"create a {noun}", needs=needs)


async def _is_affiliated(db: Connection, actor: Actor) -> bool:
    mine = (membership.c.person_id == actor.person_id) & unexpired(membership.c.expires_at)
    affiliated = exists().where(
        mine, access_group.c.id == membership.c.group_id, access_group.c.kind == GroupKind.affiliation.value
    )
    found = await db.execute(select(affiliated | ~exists(select(affiliation_domain.c.domain))))
    return bool(found.scalar_one())


async def grant_first_rights(db: Connection, actor: Actor, project_id: uuid.UUID) -> dict[str, Right]:
    """Make whoever made a project its owner, and give each affiliation group what the settings say; return these.

    Raises:
        LastOwner: its maker left meanwhile.
    """
    await lock_rights(db)
    await own_project(db, project_id=project_id, group_id=await own_group(db, actor.person_id))
    stmt = select(access_group.c.id, access_group.c.name, affiliation.c.default_level).join(affiliation)
    rows = (await db.execute(stmt.where(affiliation.c.default_level.is_not(None)))).all()
    if rows:
        place = {"project_id": project_id, "granted_by_id": actor.person_id}
        given = [{"group_id": row.id, "level": row.default_level, "id": uuid.uuid4(), **place} for row in rows]
        await db.execute(insert(access_grant), given)
    await ensure_owner_remains(db, [project_id])
    return {row.name: Right.of_level(row.default_level) for row in rows}
