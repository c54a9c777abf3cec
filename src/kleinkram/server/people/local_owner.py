"""The local owner of a standalone server: one person, whose token `klein up` wrote to a file.

A token that was revoked stays so: where it is the file's, the next start writes another into it.
"""

import asyncio
import logging
import os
import uuid
from pathlib import Path

from sqlalchemy import func, insert, select, update

from kleinkram.contract.access import Scope
from kleinkram.contract.tokens import SecretKind
from kleinkram.server.access.actor import secret_hash
from kleinkram.server.access.groups import OWNER_ID, OWNER_TOKEN_NAME, add_person, make_admin
from kleinkram.server.access.secrets import beginning, new_secret
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection
from kleinkram.server.tables import person, token

_log = logging.getLogger("kleinkram.owner")
OWNER_NAME = "owner"


async def let_owner_in(db: Connection, token_file: Path) -> None:
    """Make the local owner exist, with the token in a file; one that was revoked is replaced there by a new one.

    Raises:
        RuntimeError: a new one cannot be written there.
    """
    held = (await asyncio.to_thread(token_file.read_text, encoding="ascii")).strip()
    if held and await ensure_owner(db, held):
        return
    renewed = new_secret(SecretKind.personal).text
    await ensure_owner(db, renewed)
    try:
        await asyncio.to_thread(_write_private, token_file, renewed + "\n")
    except OSError as error:
        raise RuntimeError(f"the owner's token was revoked, and {token_file} takes no other: {error}") from error
    _log.warning("the owner's token was revoked: there is a new one", extra={"fields": {"file": str(token_file)}})


async def ensure_owner(db: Connection, secret_token: str) -> bool:
    """Make the local owner exist, with exactly this token; an older one stops working. What changed is recorded.

    Returns whether it is theirs: one that was revoked is not, and then nothing changes.
    """
    await add_person(db, name=OWNER_NAME, person_id=OWNER_ID)
    await make_admin(db, OWNER_ID)
    # Processes that start together do this one after the other.
    await db.execute(select(person.c.id).where(person.c.id == OWNER_ID).with_for_update(key_share=True))
    secret = secret_hash(secret_token)
    held = (await db.execute(select(token.c.revoked_at).where(token.c.secret_sha256 == secret))).one_or_none()
    if held is not None:
        return held.revoked_at is None
    stale = (token.c.person_id == OWNER_ID) & (token.c.name == OWNER_TOKEN_NAME) & token.c.revoked_at.is_(None)
    revoked = await db.execute(update(token).where(stale).values(revoked_at=func.now()).returning(token.c.id))
    made = uuid.uuid4()
    values = {"id": made, "person_id": OWNER_ID, "name": OWNER_TOKEN_NAME, "secret_sha256": secret}
    values |= {"prefix": beginning(secret_token)}
    await db.execute(insert(token).values(scopes=[Scope.admin.value], **values))
    events = [Event("token.revoke", "token", token_id, OWNER_TOKEN_NAME, None) for token_id in revoked.scalars()]
    await record(db, None, *events, Event("token.create", "token", made, OWNER_TOKEN_NAME, None))
    return True


def _write_private(path: Path, text: str) -> None:
    """Write a file of mode 0600 whole, or not at all."""
    unfinished = path.with_name(path.name + ".new")
    unfinished.unlink(missing_ok=True)
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(text)
        file.flush()
        os.fsync(descriptor)
    unfinished.rename(path)
