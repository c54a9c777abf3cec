"""The first admin of a new server, and the owner of `klein up`: both prove that they can read the server's output."""

import logging
import uuid

from sqlalchemy import exists, func, select

from kleinkram.contract.accounts import AdminBootstrap, OneTimeLink
from kleinkram.contract.errors import CodeGone, FieldProblem, Forbidden, InvalidRequest, SignInRefused
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.groups import ADMINS_ID, OWNER_ID, add_person, make_admin, prove_address
from kleinkram.server.audit.service import Event, record
from kleinkram.server.auth.local_accounts import refuse_obvious_password, set_password
from kleinkram.server.auth.one_time_codes import CodeRequest, create_code, use_code
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings
from kleinkram.server.tables import membership, person
from kleinkram.server.tables.signing_in import CodePurpose

_log = logging.getLogger("kleinkram.auth")
# Serializes bootstraps, so that the second one finds an admin.
_BOOTSTRAP_LOCK = 0x6B6C434C
_CODE_LIFETIME_S = 7 * 86_400


async def has_admin(db: Connection) -> bool:
    """Whether the server has an active admin."""
    active = person.c.deactivated_at.is_(None) & unexpired(membership.c.expires_at)
    admins = exists().where(membership.c.group_id == ADMINS_ID, membership.c.person_id == person.c.id, active)
    return bool((await db.execute(select(admins))).scalar_one())


async def log_bootstrap_code(db: Connection) -> None:
    """If the server has no admin, log a code that makes one: the only secret that is ever logged."""
    if await has_admin(db):
        return
    code = await create_code(db, CodeRequest(CodePurpose.bootstrap, _CODE_LIFETIME_S))
    _log.warning("this server has no admin yet; bootstrap code: %s", code.secret)


async def bootstrap_admin(
    db: Connection, actor: Actor, *, bootstrap: AdminBootstrap, password_hash: str | None
) -> uuid.UUID:
    """Make the signed-in person, or a new local account, the first admin; returns the person.

    Raises:
        CodeGone: the code is not valid, or the server has an admin.
        InvalidRequest: a new account requires a name, an address and a password.
        SignInRefused: the address belongs to another account.
    """
    await db.execute(select(func.pg_advisory_xact_lock(_BOOTSTRAP_LOCK)))
    if await has_admin(db):
        raise CodeGone
    await use_code(db, bootstrap.code, CodePurpose.bootstrap)
    person_id, name = actor.person_id, actor.name
    if person_id is None:
        person_id, name = await _new_account(db, bootstrap, password_hash)
    await make_admin(db, person_id)
    await record(
        db, actor, Event("server.bootstrap", "person", person_id, name, None, after={"email": bootstrap.email})
    )
    return person_id


async def create_owner_link(db: Connection, actor: Actor, *, settings: Settings) -> OneTimeLink:
    """Return a link with which the owner of `klein up` signs in.

    Raises:
        Forbidden: the actor is not the owner.
    """
    if actor.person_id != OWNER_ID:
        raise Forbidden(noun="server", operation="sign in as its owner", needs="the owner's token")
    code = await create_code(db, CodeRequest(CodePurpose.owner, settings.owner_link_s, person_id=OWNER_ID))
    after: Metadata = {"expires_at": code.expires_at.isoformat()}
    await record(db, actor, Event("link.create", "person", OWNER_ID, actor.name, None, after=after))
    return code.link(settings, CodePurpose.owner)


async def _new_account(db: Connection, bootstrap: AdminBootstrap, password_hash: str | None) -> tuple[uuid.UUID, str]:
    missing = [
        FieldProblem(field=field, message="is missing")
        for field in ("name", "email", "password")
        if getattr(bootstrap, field) is None
    ]
    if bootstrap.name is None or bootstrap.email is None or bootstrap.password is None or password_hash is None:
        raise InvalidRequest(problems=missing)
    refuse_obvious_password(bootstrap.password, field="password", about=(bootstrap.name, bootstrap.email))
    person_id = await add_person(db, name=bootstrap.name)
    if not await prove_address(db, person_id, bootstrap.email, by="bootstrap"):
        raise SignInRefused(
            reason=f"{bootstrap.email} has an account already. Sign in with it, then become the first admin."
        )
    await set_password(db, person_id, password_hash)
    return person_id, bootstrap.name
