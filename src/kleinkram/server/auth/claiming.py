"""The first admin of a fresh server, and the owner of `klein up`: both prove that they read what the server wrote."""

import logging
import uuid

from sqlalchemy import exists, func, select

from kleinkram.contract.accounts import Claim, OneTimeLink
from kleinkram.contract.errors import CodeGone, FieldProblem, Forbidden, InvalidRequest, SignInRefused
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.groups import ADMINS_ID, OWNER_ID, add_person, make_admin, prove_address
from kleinkram.server.audit.service import Event, record
from kleinkram.server.auth.codes import CodeWanted, make_code, use_code
from kleinkram.server.auth.local import keep_first_password
from kleinkram.server.auth.passwords import refuse_obvious
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings
from kleinkram.server.tables import membership, person
from kleinkram.server.tables.signing_in import CodePurpose

_log = logging.getLogger("kleinkram.auth")
# Two claims at a time are one after the other: the second finds an admin.
_CLAIMING = 0x6B6C434C
_CLAIM_S = 7 * 86_400


async def has_admin(db: Connection) -> bool:
    """Say whether anybody is an admin."""
    active = person.c.deactivated_at.is_(None) & unexpired(membership.c.expires_at)
    found = exists().where(membership.c.group_id == ADMINS_ID, membership.c.person_id == person.c.id, active)
    return bool((await db.execute(select(found))).scalar_one())


async def offer_claim(db: Connection) -> None:
    """Where nobody is admin yet, write a code to the log that makes one: the one secret that is ever logged."""
    if await has_admin(db):
        return
    code = await make_code(db, CodeWanted(CodePurpose.claim, _CLAIM_S))
    _log.warning("nobody is admin of this server yet; claim code: %s", code.secret)


async def claim(db: Connection, asker: Actor, *, claimed: Claim, hashed: str | None) -> uuid.UUID:
    """Make the first admin: who is signed in, else a new local account. Returns who it is.

    Raises:
        CodeGone: the code is not good, or there is an admin.
        InvalidRequest: a new account needs a name, an address and a password.
        SignInRefused: the address is somebody's.
    """
    await db.execute(select(func.pg_advisory_xact_lock(_CLAIMING)))
    if await has_admin(db):
        raise CodeGone
    await use_code(db, claimed.code, CodePurpose.claim)
    person_id, name = asker.person_id, asker.name
    if person_id is None:
        person_id, name = await _new_account(db, claimed, hashed)
    await make_admin(db, person_id)
    await record(db, asker, Event("server.claim", "person", person_id, name, None, after={"email": claimed.email}))
    return person_id


async def owner_link(db: Connection, actor: Actor, *, settings: Settings) -> OneTimeLink:
    """Return a link by which the owner of `klein up` signs in, for whoever has the owner's token.

    Raises:
        Forbidden: it is not the owner who asks.
    """
    if actor.person_id != OWNER_ID:
        raise Forbidden(noun="server", operation="sign in as its owner", needs="the owner's token")
    code = await make_code(db, CodeWanted(CodePurpose.owner, settings.owner_link_s, person_id=OWNER_ID))
    after: Metadata = {"expires_at": code.expires_at.isoformat()}
    await record(db, actor, Event("link.create", "person", OWNER_ID, actor.name, None, after=after))
    return code.link(settings, CodePurpose.owner)


async def _new_account(db: Connection, claimed: Claim, hashed: str | None) -> tuple[uuid.UUID, str]:
    missing = [
        FieldProblem(field=field, message="is missing")
        for field in ("name", "email", "password")
        if getattr(claimed, field) is None
    ]
    if claimed.name is None or claimed.email is None or claimed.password is None or hashed is None:
        raise InvalidRequest(problems=missing)
    refuse_obvious(claimed.password, field="password", about=(claimed.name, claimed.email))
    person_id = await add_person(db, name=claimed.name)
    if not await prove_address(db, person_id, claimed.email, by="claim"):
        raise SignInRefused(reason=f"{claimed.email} is somebody's already. Sign in with it, then claim the server.")
    await keep_first_password(db, person_id, hashed)
    return person_id, claimed.name
