"""Identities of providers and the accounts they open. A person has one account, to which they link identities.

A linked identity opens its account. An unknown one is linked automatically to the account with its address only if the
provider verified the address, the settings trust the provider for its domain, and the account has no other identity of
this provider (addresses are reassigned). Otherwise the person links it while signed in. An unlinked identity is never
linked again automatically. For an unverified address, the response does not reveal whether it has an account.
"""

import time
import uuid

from sqlalchemy import ColumnElement, exists, func, select, update
from sqlalchemy.dialects.postgresql import insert

from kleinkram.contract.accounts import MAX_PERSON_NAME_CHARACTERS, check_person_name
from kleinkram.contract.emails import check_email, email_domain, email_key
from kleinkram.contract.errors import SignInRefused
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.groups import add_person, prove_address
from kleinkram.server.audit.service import Event, record
from kleinkram.server.auth.authorization_request import VerifiedIdentity
from kleinkram.server.auth.one_time_codes import is_valid
from kleinkram.server.auth.sessions import renew_session
from kleinkram.server.db import Connection
from kleinkram.server.settings import OidcProvider, OpenTo
from kleinkram.server.tables import identity, one_time_code, person, person_email
from kleinkram.server.tables.signing_in import CodePurpose

# The maximum age of a password entry at a provider that was asked for reauthentication.
_MAX_AUTH_AGE_S = 900
# Serializes first sign-ins, so that the second one of a person finds the account of the first.
_ACCOUNT_LOCK = 0x6B6C4143


async def open_account(
    db: Connection, asker: Actor, *, verified: VerifiedIdentity, provider: OidcProvider
) -> uuid.UUID:
    """Return the person whose account an identity opens; creates or links the account if the settings allow it.

    Raises:
        SignInRefused: the person must link the identity themselves, or gets no account.
    """
    await db.execute(select(func.pg_advisory_xact_lock(_ACCOUNT_LOCK)))
    address = _address(verified)
    trusted_address = address if _is_trusted(verified, address, provider) else None
    person_id = await _find_linked_person(db, verified)
    if person_id is not None:
        await _verify_address(db, person_id, trusted_address, provider)
        return person_id
    await _require_never_linked(db, verified, provider)
    owner = await _find_address_owner(db, trusted_address)
    if owner is None:
        return await _new_account(db, asker, verified=verified, provider=provider, trusted_address=trusted_address)
    if await _has_identity_of(db, owner, provider):
        raise SignInRefused(
            reason=f"the account with {address} belongs to another identity of {provider.title}, and a reassigned "
            "address does not open it. Ask an admin of this server."
        )
    await _link(db, asker, person_id=owner, verified=verified, provider=provider)
    return owner


async def link_identity(db: Connection, actor: Actor, *, verified: VerifiedIdentity, provider: OidcProvider) -> None:
    """Link an identity to the actor's account.

    Raises:
        SignInRefused: it is linked to another account.
    """
    await db.execute(select(func.pg_advisory_xact_lock(_ACCOUNT_LOCK)))
    linked_to = await _find_linked_person(db, verified)
    if linked_to is not None and linked_to != actor.person_id:
        raise SignInRefused(reason=f"this account of {provider.title} is linked to another person's account here.")
    if linked_to is None and actor.person_id is not None:
        await _link(db, actor, person_id=actor.person_id, verified=verified, provider=provider)
    address = _address(verified)
    if actor.person_id is not None and _is_trusted(verified, address, provider):
        await _verify_address(db, actor.person_id, address, provider)


async def reauthenticate(db: Connection, actor: Actor, *, verified: VerifiedIdentity, provider: OidcProvider) -> None:
    """Record that the actor has just reauthenticated at a provider.

    Raises:
        SignInRefused: the provider names another person, or did not ask for the password.
    """
    if await _find_linked_person(db, verified) != actor.person_id:
        raise SignInRefused(reason=f"{provider.title} signed another person in. Start again with your own account.")
    if verified.auth_time is not None and verified.auth_time < time.time() - _MAX_AUTH_AGE_S:
        reason = f"{provider.title} did not ask for your password again. Sign out there, then start again."
        raise SignInRefused(reason=reason)
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


async def _require_never_linked(db: Connection, verified: VerifiedIdentity, provider: OidcProvider) -> None:
    if (await db.execute(select(identity.c.id).where(_same(verified)))).first() is not None:
        raise SignInRefused(
            reason=f"this account of {provider.title} was unlinked here. Sign in with another method and link it again "
            "on the page /account, or ask an admin of this server."
        )


async def _find_address_owner(db: Connection, address: str | None) -> uuid.UUID | None:
    if address is None:
        return None
    stmt = select(person_email.c.person_id).where(person_email.c.email_key == email_key(address))
    owner: uuid.UUID | None = (await db.execute(stmt)).scalar_one_or_none()
    return owner


async def _has_identity_of(db: Connection, person_id: uuid.UUID, provider: OidcProvider) -> bool:
    """Whether a person has, or had, an identity of a provider."""
    identities = exists().where(identity.c.person_id == person_id, identity.c.issuer == provider.issuer)
    return bool((await db.execute(select(identities))).scalar_one())


async def _verify_address(db: Connection, person_id: uuid.UUID, address: str | None, provider: OidcProvider) -> None:
    """Add a verified address to an account, unless another person has it."""
    is_deactivated = select(person.c.deactivated_at.is_not(None)).where(person.c.id == person_id)
    if address is not None and not (await db.execute(is_deactivated)).scalar_one():
        await prove_address(db, person_id, address, by=provider.issuer)


async def _link(
    db: Connection, actor: Actor, *, person_id: uuid.UUID, verified: VerifiedIdentity, provider: OidcProvider
) -> None:
    row = {"person_id": person_id, "issuer": verified.issuer, "subject": verified.subject, "email": _address(verified)}
    # An unlinked identity moves to the account that links it now.
    relinked = {**row, "created_at": func.now(), "last_used_at": func.now(), "unlinked_at": None}
    linked = insert(identity).values(id=uuid.uuid4(), **row)
    linked = linked.on_conflict_do_update(index_elements=["issuer", "subject"], set_=relinked)
    identity_id: uuid.UUID = (await db.execute(linked.returning(identity.c.id))).scalar_one()
    after: Metadata = {"issuer": verified.issuer, "email": verified.email, "person_id": str(person_id)}
    await record(db, actor, Event("identity.link", "identity", identity_id, provider.title, None, after=after))


async def _new_account(
    db: Connection, asker: Actor, *, verified: VerifiedIdentity, provider: OidcProvider, trusted_address: str | None
) -> uuid.UUID:
    is_invited = trusted_address is not None and await _use_invitations(db, trusted_address)
    if not is_invited:
        _require_open_registration(verified, provider, trusted_address)
    name = _name(verified)
    person_id = await add_person(db, name=name)
    after: Metadata = {"method": provider.issuer, "email": verified.email, "by_invitation": is_invited}
    await record(db, asker, Event("person.create", "person", person_id, name, None, after=after))
    await _link(db, asker, person_id=person_id, verified=verified, provider=provider)
    await _verify_address(db, person_id, trusted_address, provider)
    return person_id


def _require_open_registration(verified: VerifiedIdentity, provider: OidcProvider, trusted_address: str | None) -> None:
    if provider.open_to is OpenTo.anybody:
        return
    linking = (
        f"If you have an account, sign in as before and add {provider.title} to it: "
        "“Link another sign-in method” on the page /account."
    )
    if provider.open_to is OpenTo.invited:
        raise SignInRefused(
            reason=f"accounts on this server require an invitation. {linking} Otherwise ask an admin for one."
        )
    if trusted_address is None:
        who = f"{verified.email or 'your account'} of {provider.title}"
        raise SignInRefused(
            reason=f"{who} does not get an account here automatically. {linking} "
            "Otherwise ask an admin of this server for an invitation."
        )


async def _use_invitations(db: Connection, address: str) -> bool:
    """Use the invitations to an address up; returns whether there was one."""
    unused = (
        *is_valid(),
        one_time_code.c.purpose == CodePurpose.invitation.value,
        func.lower(one_time_code.c.email) == email_key(address),
    )
    stmt = update(one_time_code).where(*unused).values(used_at=func.now()).returning(one_time_code.c.id)
    return (await db.execute(stmt)).first() is not None


def _name(verified: VerifiedIdentity) -> str:
    """Return the name from the provider, else the local part of the address."""
    for candidate in (verified.name, (verified.email or "").partition("@")[0]):
        name = "".join(letter for letter in candidate or "" if letter.isprintable())[
            :MAX_PERSON_NAME_CHARACTERS
        ].strip()
        if name:
            return check_person_name(name)
    return "somebody without a name"
