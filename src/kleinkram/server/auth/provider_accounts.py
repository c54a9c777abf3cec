"""Sign-in with identity providers: authorization requests, and the accounts that identities open.

A request is bound to the browser by a cookie, is valid once, and expires after some minutes.

A person has one account, to which they link identities. An unknown identity is linked automatically to the account with
its address only if the provider verified the address, the settings trust the provider for its domain, and the account
has no other identity of this provider (addresses are reassigned). Otherwise the person links it while signed in. An
unlinked identity is never linked again automatically. For an unverified address, the response does not reveal whether
it has an account.
"""

import datetime
import secrets
import time
import uuid
from dataclasses import dataclass, field

from sqlalchemy import ColumnElement, delete, exists, func, insert, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.accounts import MAX_PERSON_NAME_CHARACTERS, check_person_name
from kleinkram.contract.errors import SignInRefused
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import check_email, email_domain, email_key
from kleinkram.server.access.actor import Actor, secret_hash
from kleinkram.server.access.builtin_groups import add_person, add_verified_address
from kleinkram.server.access.rights import ensure_active_person
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.auth.one_time_codes import is_valid
from kleinkram.server.auth.sessions import renew_session
from kleinkram.server.db import Connection
from kleinkram.server.settings import OidcProvider, OpenTo
from kleinkram.server.tables import identity, oidc_login, one_time_code, person, person_email
from kleinkram.server.tables.sign_in import CodePurpose

REQUEST_LIFETIME_S = 600
_SECRET_BYTES = 32


@dataclass(frozen=True)
class VerifiedIdentity:
    """The person whom a provider identified. `email_verified` is the provider's claim."""

    issuer: str
    subject: str
    email: str | None
    email_verified: bool
    name: str | None
    # When they last entered their password there, if the provider sends it: seconds since 1970, by its clock.
    auth_time: int | None = None
    # The id of their session there, if the provider sends it.
    session_id: str | None = None
    # With which the account can be checked later, if the provider grants one.
    refresh_token: str | None = field(default=None, repr=False)


@dataclass(frozen=True)
class AuthorizationRequest:
    """One request; `state` travels through the browser, the other secrets stay on the server.

    With `session_id`, the signed-in person links an identity to their account or, with `reauthenticates`, signs in
    again.
    """

    return_to: str
    session_id: uuid.UUID | None = None
    reauthenticates: bool = False
    state: str = field(default_factory=lambda: secrets.token_urlsafe(_SECRET_BYTES), repr=False)
    nonce: str = field(default_factory=lambda: secrets.token_urlsafe(_SECRET_BYTES), repr=False)
    code_verifier: str = field(default_factory=lambda: secrets.token_urlsafe(_SECRET_BYTES), repr=False)


async def store_request(db: Connection, request: AuthorizationRequest, *, provider: str, browser_secret: str) -> None:
    """Store a request for its callback."""
    await db.execute(delete(oidc_login).where(oidc_login.c.expires_at < func.now()))
    await db.execute(
        insert(oidc_login).values(
            state_sha256=secret_hash(request.state),
            provider=provider,
            nonce=request.nonce,
            code_verifier=request.code_verifier,
            browser_sha256=secret_hash(browser_secret),
            session_id=request.session_id,
            reauthenticates=request.reauthenticates,
            return_to=request.return_to,
            expires_at=func.now() + datetime.timedelta(seconds=REQUEST_LIFETIME_S),
        )
    )


async def take_request(db: Connection, *, provider: str, state: str, browser_secret: str) -> AuthorizationRequest:
    """Return and delete the request of a callback, so that a replayed callback finds nothing. Raises SignInRefused."""
    conditions = (
        oidc_login.c.state_sha256 == secret_hash(state),
        oidc_login.c.browser_sha256 == secret_hash(browser_secret),
        oidc_login.c.provider == provider,
        oidc_login.c.expires_at > func.now(),
    )
    row = (await db.execute(delete(oidc_login).where(*conditions).returning(*oidc_login.c))).one_or_none()
    if row is None:
        raise SignInRefused(
            reason="this sign-in was not started in this browser, was finished before, or has expired. Start again."
        )
    return AuthorizationRequest(
        row.return_to, row.session_id, row.reauthenticates, state, nonce=row.nonce, code_verifier=row.code_verifier
    )


# The maximum age of a password entry at a provider that was asked for reauthentication.
_MAX_AUTH_AGE_S = 900
_ACCOUNT_LOCK = 0x6B6C4143


async def lock_identities(db: Connection) -> None:
    """Serialize sign-ins with providers, so that the second one of a person finds the account of the first.

    Erasing a person begins with it, too: otherwise, an address or identity could be added to them concurrently.
    """
    await db.execute(select(func.pg_advisory_xact_lock(_ACCOUNT_LOCK)))


async def open_account(
    db: Connection, requester: Actor, *, verified: VerifiedIdentity, provider: OidcProvider
) -> uuid.UUID:
    """Return the person whose account an identity opens; creates or links the account if the settings allow it.

    Raises SignInRefused.
    """
    await lock_identities(db)
    address = _address(verified)
    trusted_address = address if _is_trusted(verified, address, provider) else None
    person_id = await _find_linked_person(db, verified)
    if person_id is not None:
        await _verify_address(db, person_id, trusted_address, provider)
        return person_id
    if (await db.execute(select(identity.c.id).where(_same(verified)))).first() is not None:
        raise SignInRefused(
            reason=f"this account of {provider.title} was unlinked here. Sign in with another method and link it again "
            "on the page /account, or ask an admin of this server."
        )
    owner: uuid.UUID | None = None
    if trusted_address is not None:
        owners = select(person_email.c.person_id).where(person_email.c.email_key == email_key(trusted_address))
        owner = (await db.execute(owners)).scalar_one_or_none()
    if owner is None:
        return await _new_account(db, requester, verified=verified, provider=provider, trusted_address=trusted_address)
    # Also unlinked ones: the address may be reassigned.
    others = exists().where(identity.c.person_id == owner, identity.c.issuer == provider.issuer)
    if (await db.execute(select(others))).scalar_one():
        raise SignInRefused(
            reason=f"the account with {address} belongs to another identity of {provider.title}, and a reassigned "
            "address does not open it. Ask an admin of this server."
        )
    await _link(db, requester, person_id=owner, verified=verified, provider=provider)
    return owner


async def confirm_identity(db: Connection, verified: VerifiedIdentity) -> uuid.UUID:
    """Record that a provider has just confirmed a linked identity, and return its id."""
    now = {"confirmed_at": func.now(), "checked_at": func.now()}
    # Some providers send a refresh token only at the first sign-in.
    refresh_token = func.coalesce(verified.refresh_token, identity.c.refresh_token)
    confirm = update(identity).where(_same(verified)).values(**now, refresh_token=refresh_token)
    identity_id: uuid.UUID = (await db.execute(confirm.returning(identity.c.id))).scalar_one()
    return identity_id


async def link_identity(db: Connection, actor: Actor, *, verified: VerifiedIdentity, provider: OidcProvider) -> None:
    """Link an identity to the actor's account. Raises SignInRefused, or NotAuthenticated if it was erased just now."""
    await lock_identities(db)
    await ensure_active_person(db, actor.person_id)
    linked_to = await _find_linked_person(db, verified)
    if linked_to is not None and linked_to != actor.person_id:
        raise SignInRefused(reason=f"this account of {provider.title} is linked to another person's account here.")
    if linked_to is None and actor.person_id is not None:
        await _link(db, actor, person_id=actor.person_id, verified=verified, provider=provider)
    address = _address(verified)
    if actor.person_id is not None and _is_trusted(verified, address, provider):
        await _verify_address(db, actor.person_id, address, provider)


async def reauthenticate(db: Connection, actor: Actor, *, verified: VerifiedIdentity, provider: OidcProvider) -> None:
    """Record that the actor has just reauthenticated at a provider. Raises SignInRefused."""
    if await _find_linked_person(db, verified) != actor.person_id:
        raise SignInRefused(reason=f"{provider.title} signed another person in. Start again with your own account.")
    if verified.auth_time is not None and verified.auth_time < time.time() - _MAX_AUTH_AGE_S:
        reason = f"{provider.title} did not ask for your password again. Sign out there, then start again."
        raise SignInRefused(reason=reason)
    await confirm_identity(db, verified)
    await renew_session(db, actor, method=provider.issuer)


def _address(verified: VerifiedIdentity) -> str | None:
    """Return the provider's address if it is valid."""
    try:
        return None if verified.email is None else check_email(verified.email)
    except ValueError:
        return None


def _is_trusted(verified: VerifiedIdentity, address: str | None, provider: OidcProvider) -> bool:
    return address is not None and verified.email_verified and provider.trusts(email_domain(address))


async def _find_linked_person(db: Connection, verified: VerifiedIdentity) -> uuid.UUID | None:
    linked = _same(verified) & identity.c.unlinked_at.is_(None)
    stmt = update(identity).where(linked).values(last_used_at=func.now(), email=_address(verified))
    person_id: uuid.UUID | None = (await db.execute(stmt.returning(identity.c.person_id))).scalar_one_or_none()
    return person_id


def _same(verified: VerifiedIdentity) -> ColumnElement[bool]:
    return (identity.c.issuer == verified.issuer) & (identity.c.subject == verified.subject)


async def _verify_address(db: Connection, person_id: uuid.UUID, address: str | None, provider: OidcProvider) -> None:
    """Add a verified address to an account, unless another person has it."""
    is_deactivated = select(person.c.deactivated_at.is_not(None)).where(person.c.id == person_id)
    if address is not None and not (await db.execute(is_deactivated)).scalar_one():
        await add_verified_address(db, person_id, address, by=provider.issuer)


async def _link(
    db: Connection, actor: Actor, *, person_id: uuid.UUID, verified: VerifiedIdentity, provider: OidcProvider
) -> None:
    row = {"person_id": person_id, "issuer": verified.issuer, "subject": verified.subject, "email": _address(verified)}
    # An unlinked identity moves to the account that links it now.
    relinked = {**row, "created_at": func.now(), "last_used_at": func.now(), "unlinked_at": None}
    linked = upsert(identity).values(id=uuid.uuid4(), **row)
    linked = linked.on_conflict_do_update(index_elements=["issuer", "subject"], set_=relinked)
    identity_id: uuid.UUID = (await db.execute(linked.returning(identity.c.id))).scalar_one()
    after: Metadata = {"issuer": verified.issuer, "email": verified.email, "person_id": str(person_id)}
    await audit(db, actor, Event("identity.link", "identity", identity_id, provider.title, after=after))


async def _new_account(
    db: Connection, requester: Actor, *, verified: VerifiedIdentity, provider: OidcProvider, trusted_address: str | None
) -> uuid.UUID:
    is_invited = False
    if trusted_address is not None:
        is_invitation = one_time_code.c.purpose == CodePurpose.invitation.value
        is_theirs = func.lower(one_time_code.c.email) == email_key(trusted_address)
        stmt = update(one_time_code).where(*is_valid(), is_invitation, is_theirs).values(used_at=func.now())
        is_invited = (await db.execute(stmt.returning(one_time_code.c.id))).first() is not None
    if not is_invited:
        _require_open_registration(verified, provider, trusted_address)
    # The name from the provider, else the local part of the address.
    name = "somebody without a name"
    for candidate in (verified.name, (verified.email or "").partition("@")[0]):
        printable = "".join(letter for letter in candidate or "" if letter.isprintable())
        if shortened := printable[:MAX_PERSON_NAME_CHARACTERS].strip():
            name = check_person_name(shortened)
            break
    person_id = await add_person(db, name=name)
    after: Metadata = {"method": provider.issuer, "email": verified.email, "by_invitation": is_invited}
    await audit(db, requester, Event("person.create", "person", person_id, name, after=after))
    await _link(db, requester, person_id=person_id, verified=verified, provider=provider)
    await _verify_address(db, person_id, trusted_address, provider)
    return person_id


def _require_open_registration(verified: VerifiedIdentity, provider: OidcProvider, trusted_address: str | None) -> None:
    linking = (
        f"If you have an account, sign in as before and add {provider.title} to it: "
        "“Link another sign-in method” on the page /account."
    )
    if provider.open_to is OpenTo.invited:
        raise SignInRefused(
            reason=f"accounts on this server require an invitation. {linking} Otherwise ask an admin for one."
        )
    if provider.open_to is not OpenTo.anybody and trusted_address is None:
        who = f"{verified.email or 'your account'} of {provider.title}"
        raise SignInRefused(
            reason=f"{who} does not get an account here automatically. {linking} "
            "Otherwise ask an admin of this server for an invitation."
        )
