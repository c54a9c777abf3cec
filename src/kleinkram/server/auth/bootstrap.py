"""The first admin of a new server, and the local owner of `klein up`."""

import asyncio
import logging
import os
import uuid
from pathlib import Path

from sqlalchemy import exists, func, insert, select, update

from kleinkram.contract.access import Scope
from kleinkram.contract.accounts import AdminBootstrap, OneTimeLink
from kleinkram.contract.errors import CodeGone, FieldProblem, Forbidden, InvalidRequest, SignInRefused
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.token_format import SecretKind
from kleinkram.server.access.actor import Actor, new_secret, secret_hash, secret_prefix, unexpired
from kleinkram.server.access.builtin_groups import (
    ADMINS_ID,
    OWNER_ID,
    OWNER_TOKEN_NAME,
    add_person,
    add_verified_address,
    make_admin,
)
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.auth.local_accounts import refuse_obvious_password, set_password
from kleinkram.server.auth.one_time_codes import CodeRequest, create_code, use_code
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings
from kleinkram.server.tables import membership, person, token
from kleinkram.server.tables.sign_in import CodePurpose

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
    db: Connection, actor: Actor, *, request: AdminBootstrap, password_hash: str | None
) -> uuid.UUID:
    """Make the signed-in person, or a new local account, the first admin; returns the person.

    Raises CodeGone, InvalidRequest or SignInRefused.
    """
    await db.execute(select(func.pg_advisory_xact_lock(_BOOTSTRAP_LOCK)))
    if await has_admin(db):
        raise CodeGone
    await use_code(db, request.code, CodePurpose.bootstrap)
    person_id, name = actor.person_id, actor.name
    if person_id is None:
        if request.name is None or request.email is None or request.password is None or password_hash is None:
            missing = [field for field in ("name", "email", "password") if getattr(request, field) is None]
            raise InvalidRequest(problems=[FieldProblem(field=field, message="is missing") for field in missing])
        name = request.name
        refuse_obvious_password(request.password, field="password", about=(name, request.email))
        person_id = await add_person(db, name=name)
        if not await add_verified_address(db, person_id, request.email, by="bootstrap"):
            raise SignInRefused(
                reason=f"{request.email} has an account already. Sign in with it, then become the first admin."
            )
        await set_password(db, person_id, password_hash)
    await make_admin(db, person_id)
    event = Event("server.bootstrap", "person", person_id, name, after={"email": request.email})
    await audit(db, actor, event)
    return person_id


async def create_owner_link(db: Connection, actor: Actor, *, settings: Settings) -> OneTimeLink:
    """Return a link with which the owner of `klein up` signs in. Raises Forbidden."""
    if actor.person_id != OWNER_ID:
        raise Forbidden(resource_type="server", operation="sign in as its owner", needs="the owner's token")
    code = await create_code(db, CodeRequest(CodePurpose.owner, settings.owner_link_s, person_id=OWNER_ID))
    after: Metadata = {"expires_at": code.expires_at.isoformat()}
    await audit(db, actor, Event("link.create", "person", OWNER_ID, actor.name, after=after))
    return code.link(settings, CodePurpose.owner)


_log = logging.getLogger("kleinkram.owner")
OWNER_NAME = "owner"


async def ensure_local_owner(db: Connection, token_file: Path) -> None:
    """Create the local owner with the token in a file; a revoked token is replaced by a new one in the file.

    Raises RuntimeError.
    """
    stored = (await asyncio.to_thread(token_file.read_text, encoding="ascii")).strip()
    if stored and await ensure_owner(db, stored):
        return
    renewed = new_secret(SecretKind.personal).text
    await ensure_owner(db, renewed)
    try:
        await asyncio.to_thread(_write_private, token_file, renewed + "\n")
    except OSError as error:
        raise RuntimeError(f"the owner's token was revoked, and {token_file} takes no other: {error}") from error
    _log.warning("the owner's token was revoked: there is a new one", extra={"fields": {"file": str(token_file)}})


async def ensure_owner(db: Connection, secret_token: str) -> bool:
    """Create the local owner with exactly this token, revoke an older one, and audit the changes.

    Returns False, without changes, if the token was revoked.
    """
    await add_person(db, name=OWNER_NAME, person_id=OWNER_ID)
    await make_admin(db, OWNER_ID)
    # Serializes processes that start at the same time.
    await db.execute(select(person.c.id).where(person.c.id == OWNER_ID).with_for_update(key_share=True))
    secret = secret_hash(secret_token)
    stored = (await db.execute(select(token.c.revoked_at).where(token.c.secret_sha256 == secret))).one_or_none()
    if stored is not None:
        return stored.revoked_at is None
    is_outdated = (token.c.person_id == OWNER_ID) & (token.c.name == OWNER_TOKEN_NAME) & token.c.revoked_at.is_(None)
    revoked = await db.execute(update(token).where(is_outdated).values(revoked_at=func.now()).returning(token.c.id))
    new_id = uuid.uuid4()
    values = {"id": new_id, "person_id": OWNER_ID, "name": OWNER_TOKEN_NAME, "secret_sha256": secret}
    values |= {"prefix": secret_prefix(secret_token)}
    await db.execute(insert(token).values(scopes=[Scope.admin.value], **values))
    events = [Event("token.revoke", "token", token_id, OWNER_TOKEN_NAME) for token_id in revoked.scalars()]
    await audit(db, None, *events, Event("token.create", "token", new_id, OWNER_TOKEN_NAME))
    return True


def _write_private(path: Path, text: str) -> None:
    """Write a file of mode 0600 atomically."""
    unfinished = path.with_name(path.name + ".new")
    unfinished.unlink(missing_ok=True)
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(text)
        file.flush()
        os.fsync(descriptor)
    unfinished.rename(path)
