"""The local owner of a standalone server: one person, whose token `klein up` wrote to a file."""

import uuid

from sqlalchemy import func, insert, select, update

from kleinkram.contract.rights import Scope
from kleinkram.server.access.actor import secret_hash
from kleinkram.server.access.groups import add_person, make_admin
from kleinkram.server.access.secrets import beginning
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection
from kleinkram.server.tables import person, token

# Fixed, so that every start finds the same person without a search by name.
OWNER_ID = uuid.UUID("6f776e65-7200-4000-8000-000000000001")
OWNER_NAME = "owner"
_TOKEN_NAME = "local owner"  # noqa: S105  the token's label, not its secret


async def ensure_owner(db: Connection, secret_token: str) -> None:
    """Make the local owner exist, with exactly this token; an older one stops working. What changed is recorded."""
    await add_person(db, name=OWNER_NAME, person_id=OWNER_ID)
    await make_admin(db, OWNER_ID)
    # Processes that start together do this one after the other.
    await db.execute(select(person.c.id).where(person.c.id == OWNER_ID).with_for_update(key_share=True))
    secret = secret_hash(secret_token)
    held = await db.execute(select(token.c.id).where(token.c.secret_sha256 == secret, token.c.revoked_at.is_(None)))
    if held.first() is not None:
        return
    stale = (token.c.person_id == OWNER_ID) & (token.c.name == _TOKEN_NAME) & token.c.revoked_at.is_(None)
    revoked = await db.execute(update(token).where(stale).values(revoked_at=func.now()).returning(token.c.id))
    made = uuid.uuid4()
    values = {"id": made, "person_id": OWNER_ID, "name": _TOKEN_NAME, "secret_sha256": secret}
    values |= {"prefix": beginning(secret_token)}
    await db.execute(insert(token).values(scopes=[Scope.admin.value], **values))
    events = [Event("token.revoke", "token", token_id, _TOKEN_NAME, None) for token_id in revoked.scalars()]
    await record(db, None, *events, Event("token.create", "token", made, _TOKEN_NAME, None))
