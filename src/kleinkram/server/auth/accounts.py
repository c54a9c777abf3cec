"""Whose account a provider's word opens: one person is one account, under as many identities as they linked to it.

An identity that is known opens its account. One that is not is linked to the account of its address only where the
provider verified that address, the settings trust it for that domain, and the provider does not know that account's
owner as somebody else: addresses are given to new people. Else the person links it, signed in. One that was unlinked
is linked again by who is signed in, never by itself. Whoever's address is not proven is told nothing of it: the answer
is the same whether it has an account or not.
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
from kleinkram.server.auth.codes import good_still
from kleinkram.server.auth.providers import Vouched
from kleinkram.server.auth.sessions import renew_session
from kleinkram.server.db import Connection
from kleinkram.server.settings import OidcProvider, OpenTo
from kleinkram.server.tables import identity, one_time_code, person, person_email
from kleinkram.server.tables.signing_in import CodePurpose

# How long ago somebody may have given their password to a provider that was asked to ask for it: the way back lasts.
_LATELY_S = 900
# Two first sign-ins of one person are one after the other: the second finds the account of the first.
_MAKING = 0x6B6C4143


async def open_account(db: Connection, asker: Actor, *, vouched: Vouched, provider: OidcProvider) -> uuid.UUID:
    """Return whose account somebody signs in to, made or linked where the settings allow that.

    Raises:
        SignInRefused: their account has to be linked by themselves, or they get none here.
    """
    await db.execute(select(func.pg_advisory_xact_lock(_MAKING)))
    address = _address(vouched)
    proven = address if _is_trusted(vouched, address, provider) else None
    known = await _use_identity(db, vouched)
    if known is not None:
        await _prove(db, known, proven, provider)
        return known
    await _see_that_it_was_not_unlinked(db, vouched, provider)
    owner = await _owner_of(db, proven)
    if owner is None:
        return await _new_account(db, asker, vouched=vouched, provider=provider, proven=proven)
    if await _is_known_to(db, owner, provider):
        raise SignInRefused(
            reason=f"{provider.title} knows the owner of the account with {address} here as somebody else: an address "
            "that was given to another person does not open it. Ask one of this server's admins."
        )
    await _link(db, asker, person_id=owner, vouched=vouched, provider=provider)
    return owner


async def link_identity(db: Connection, actor: Actor, *, vouched: Vouched, provider: OidcProvider) -> None:
    """Add an identity to the account of who is signed in.

    Raises:
        SignInRefused: it opens another account already.
    """
    await db.execute(select(func.pg_advisory_xact_lock(_MAKING)))
    known = await _use_identity(db, vouched)
    if known is not None and known != actor.person_id:
        raise SignInRefused(reason=f"this account of {provider.title} opens somebody else's account here.")
    if known is None and actor.person_id is not None:
        await _link(db, actor, person_id=actor.person_id, vouched=vouched, provider=provider)
    address = _address(vouched)
    if actor.person_id is not None and _is_trusted(vouched, address, provider):
        await _prove(db, actor.person_id, address, provider)


async def renew_sign_in(db: Connection, actor: Actor, *, vouched: Vouched, provider: OidcProvider) -> None:
    """Note that whoever is signed in has just proven once more who they are, to a provider.

    Raises:
        SignInRefused: the provider names somebody else, or somebody who did not give their password just now.
    """
    if await _use_identity(db, vouched) != actor.person_id:
        raise SignInRefused(reason=f"{provider.title} signed somebody else in. Begin again with your own account.")
    if vouched.auth_time is not None and vouched.auth_time < time.time() - _LATELY_S:
        reason = f"{provider.title} did not ask for your password again. Sign out there, then begin again."
        raise SignInRefused(reason=reason)
    await renew_session(db, actor, way=provider.issuer)


def _address(vouched: Vouched) -> str | None:
    """Return the address that somebody is told to have, if it is one that is taken."""
    try:
        return None if vouched.email is None else check_email(vouched.email)
    except ValueError:
        return None


def _is_trusted(vouched: Vouched, address: str | None, provider: OidcProvider) -> bool:
    return address is not None and vouched.email_verified and provider.trusts(email_domain(address))


async def _use_identity(db: Connection, vouched: Vouched) -> uuid.UUID | None:
    linked = _same(vouched) & identity.c.unlinked_at.is_(None)
    stmt = update(identity).where(linked).values(last_used_at=func.now(), email=_address(vouched))
    person_id: uuid.UUID | None = (await db.execute(stmt.returning(identity.c.person_id))).scalar_one_or_none()
    return person_id


def _same(vouched: Vouched) -> ColumnElement[bool]:
    return (identity.c.issuer == vouched.issuer) & (identity.c.subject == vouched.subject)


async def _see_that_it_was_not_unlinked(db: Connection, vouched: Vouched, provider: OidcProvider) -> None:
    if (await db.execute(select(identity.c.id).where(_same(vouched)))).first() is not None:
        raise SignInRefused(
            reason=f"this account of {provider.title} was unlinked here. Sign in another way, and link it again on the "
            "page /account, or ask one of this server's admins."
        )


async def _owner_of(db: Connection, address: str | None) -> uuid.UUID | None:
    if address is None:
        return None
    stmt = select(person_email.c.person_id).where(person_email.c.email_key == email_key(address))
    owner: uuid.UUID | None = (await db.execute(stmt)).scalar_one_or_none()
    return owner


async def _is_known_to(db: Connection, person_id: uuid.UUID, provider: OidcProvider) -> bool:
    """Say whether somebody has signed in by a provider, which knows one person by one identity; if only once."""
    theirs = exists().where(identity.c.person_id == person_id, identity.c.issuer == provider.issuer)
    return bool((await db.execute(select(theirs))).scalar_one())


async def _prove(db: Connection, person_id: uuid.UUID, address: str | None, provider: OidcProvider) -> None:
    """Keep a trusted address; one that somebody else has by now stays theirs."""
    left = select(person.c.deactivated_at.is_not(None)).where(person.c.id == person_id)
    if address is not None and not (await db.execute(left)).scalar_one():
        await prove_address(db, person_id, address, by=provider.issuer)


async def _link(
    db: Connection, actor: Actor, *, person_id: uuid.UUID, vouched: Vouched, provider: OidcProvider
) -> None:
    row = {"person_id": person_id, "issuer": vouched.issuer, "subject": vouched.subject, "email": _address(vouched)}
    # One that was unlinked, by whomever, is theirs who have it now.
    again = {**row, "created_at": func.now(), "last_used_at": func.now(), "unlinked_at": None}
    linked = insert(identity).values(id=uuid.uuid4(), **row)
    linked = linked.on_conflict_do_update(index_elements=["issuer", "subject"], set_=again)
    identity_id: uuid.UUID = (await db.execute(linked.returning(identity.c.id))).scalar_one()
    after: Metadata = {"issuer": vouched.issuer, "email": vouched.email, "person_id": str(person_id)}
    await record(db, actor, Event("identity.link", "identity", identity_id, provider.title, None, after=after))


async def _new_account(
    db: Connection, asker: Actor, *, vouched: Vouched, provider: OidcProvider, proven: str | None
) -> uuid.UUID:
    is_invited = proven is not None and await _take_invitations(db, proven)
    if not is_invited:
        _see_that_it_is_open(vouched, provider, proven)
    name = _name(vouched)
    person_id = await add_person(db, name=name)
    after: Metadata = {"way": provider.issuer, "email": vouched.email, "by_invitation": is_invited}
    await record(db, asker, Event("person.create", "person", person_id, name, None, after=after))
    await _link(db, asker, person_id=person_id, vouched=vouched, provider=provider)
    await _prove(db, person_id, proven, provider)
    return person_id


def _see_that_it_is_open(vouched: Vouched, provider: OidcProvider, proven: str | None) -> None:
    if provider.open_to is OpenTo.anybody:
        return
    linking = (
        f"If you have an account, sign in as you did before and add {provider.title} to it: "
        "“Link another way to sign in” on the page /account."
    )
    if provider.open_to is OpenTo.invited:
        raise SignInRefused(
            reason=f"accounts on this server are by invitation. {linking} Else ask one of its admins for one."
        )
    if proven is None:
        who = f"{vouched.email or 'your account'} of {provider.title}"
        raise SignInRefused(
            reason=f"{who} does not get an account here by itself. {linking} "
            "Else ask one of this server's admins for an invitation."
        )


async def _take_invitations(db: Connection, address: str) -> bool:
    """Use up the invitations to an address; says whether there was one."""
    open_still = (
        *good_still(),
        one_time_code.c.purpose == CodePurpose.invitation.value,
        func.lower(one_time_code.c.email) == email_key(address),
    )
    stmt = update(one_time_code).where(*open_still).values(used_at=func.now()).returning(one_time_code.c.id)
    return (await db.execute(stmt)).first() is not None


def _name(vouched: Vouched) -> str:
    """Return what somebody is called: by their provider, else before the @ of their address."""
    for told in (vouched.name, (vouched.email or "").partition("@")[0]):
        name = "".join(letter for letter in told or "" if letter.isprintable())[:MAX_PERSON_NAME_CHARACTERS].strip()
        if name:
            return check_person_name(name)
    return "somebody without a name"
