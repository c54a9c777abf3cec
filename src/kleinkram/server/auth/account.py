"""A person's own account: credential, addresses and linked identities.

The last sign-in method of an account cannot be removed. Unlinking an identity ends no sessions or tokens.
"""

import datetime
import uuid
from collections.abc import Sequence
from typing import Any, NamedTuple

from sqlalchemy import Select, exists, func, select, update

from kleinkram.contract.accounts import AccountRead, AddressRead, IdentityRead
from kleinkram.contract.errors import LastSignInMethod, NotAuthenticated, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.rights import GroupKind, Scope
from kleinkram.contract.signing_in import CredentialKind, CredentialRead, MeRead
from kleinkram.server.access.actor import Actor, ActorKind, unexpired
from kleinkram.server.access.groups import OWNER_ID
from kleinkram.server.access.rights import lock_person
from kleinkram.server.audit.service import Event, record
from kleinkram.server.auth.totp import read_totp
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings
from kleinkram.server.tables import access_group, identity, membership, password, person, person_email, session, token


class _Identity(NamedTuple):
    id: uuid.UUID
    issuer: str
    email: str | None
    created_at: datetime.datetime
    last_used_at: datetime.datetime


async def get_me(db: Connection, actor: Actor) -> MeRead:
    """Return the actor and their credential.

    Addresses and groups are left out for tokens of robots and runners, which may be lost with their machine.

    Raises:
        NotAuthenticated: the actor has no account.
    """
    if actor.ref is None:
        raise NotAuthenticated(reason="this requires an account")
    is_person = actor.limits is None and actor.kind is ActorKind.person
    emails = select(person_email.c.email).where(
        person_email.c.person_id == actor.person_id, person_email.c.verified_at.is_not(None)
    )
    groups = (
        select(access_group.c.name)
        .join_from(membership, access_group)
        .where(
            membership.c.person_id == actor.person_id,
            unexpired(membership.c.expires_at),
            access_group.c.kind.not_in([GroupKind.person.value, GroupKind.email.value]),
        )
    )
    return MeRead(
        person=actor.ref,
        emails=sorted((await db.execute(emails)).scalars()) if is_person else [],
        groups=sorted((await db.execute(groups)).scalars()) if is_person else [],
        is_admin=actor.is_admin and Scope.admin in actor.scopes,
        credential=await _get_credential(db, actor),
    )


async def _get_credential(db: Connection, actor: Actor) -> CredentialRead:
    if actor.token_id is not None:
        row = (await db.execute(select(token).where(token.c.id == actor.token_id))).one()
        return CredentialRead(
            id=row.id,
            kind=CredentialKind(row.kind),
            name=row.name,
            scopes=[Scope(scope) for scope in row.scopes],
            is_limited=row.is_limited,
            expires_at=row.expires_at,
        )
    row = (await db.execute(select(session).where(session.c.id == actor.session_id))).one()
    return CredentialRead(
        id=row.id,
        kind=CredentialKind.session,
        name=row.method,
        scopes=sorted(actor.scopes),
        is_limited=False,
        expires_at=row.expires_at,
    )


async def get_account(db: Connection, actor: Actor, *, settings: Settings) -> AccountRead:
    """Return the actor's account.

    Raises:
        NotAuthenticated: the actor has no account.
    """
    if actor.ref is None:
        raise NotAuthenticated(reason="this requires an account")
    created_at = (await db.execute(select(person.c.created_at).where(person.c.id == actor.person_id))).scalar_one()
    groups = select(access_group.c.name).join_from(membership, access_group)
    own = (membership.c.person_id == actor.person_id) & unexpired(membership.c.expires_at)
    affiliations = groups.where(own, access_group.c.kind == GroupKind.affiliation.value)
    return AccountRead(
        person=actor.ref,
        addresses=[
            AddressRead(email=row.email, verified_at=row.verified_at, verified_by=row.verified_by)
            for row in await db.execute(_addresses(actor))
        ],
        affiliations=sorted((await db.execute(affiliations)).scalars()),
        has_password=await _has_password(db, actor, settings),
        totp=await read_totp(db, actor.person_id),
        created_at=created_at,
    )


async def list_identities(db: Connection, actor: Actor, *, settings: Settings) -> list[IdentityRead]:
    """Return the actor's linked identities in the order in which they were linked."""
    columns = [identity.c[name] for name in _Identity._fields]
    linked = (identity.c.person_id == actor.person_id) & identity.c.unlinked_at.is_(None)
    rows = await db.execute(select(*columns).where(linked).order_by(identity.c.created_at, identity.c.id))
    identities = [_Identity(*row) for row in rows]
    has_other_method = await _has_other_method(db, actor, settings)
    return [_to_read(row, identities, has_other_method=has_other_method, settings=settings) for row in identities]


async def unlink_identity(db: Connection, actor: Actor, *, identity_id: uuid.UUID, settings: Settings) -> None:
    """Unlink an identity, so that it no longer opens the account.

    Raises:
        NotFound: the actor has no linked identity with this id.
        LastSignInMethod: it is their last sign-in method.
    """
    if actor.person_id is not None:
        # Serializes concurrent requests, which could otherwise unlink all identities.
        await lock_person(db, actor.person_id)
    identities = await list_identities(db, actor, settings=settings)
    unlinked = next((candidate for candidate in identities if candidate.id == identity_id), None)
    if unlinked is None:
        raise NotFound(noun="identity", ref=str(identity_id))
    name = unlinked.provider or unlinked.issuer
    if unlinked.is_last:
        raise LastSignInMethod(provider=name)
    await db.execute(update(identity).where(identity.c.id == identity_id).values(unlinked_at=func.now()))
    before: Metadata = {"issuer": unlinked.issuer, "email": unlinked.email, "person_id": str(actor.person_id)}
    await record(db, actor, Event("identity.unlink", "identity", identity_id, name, None, before=before))


def _addresses(actor: Actor) -> Select[Any]:
    verified = (person_email.c.person_id == actor.person_id) & person_email.c.verified_at.is_not(None)
    return select(person_email).where(verified).order_by(person_email.c.email_key)


async def _has_password(db: Connection, actor: Actor, settings: Settings) -> bool:
    has_password = exists().where(password.c.person_id == actor.person_id)
    return settings.local_accounts and bool((await db.execute(select(has_password))).scalar_one())


async def _has_other_method(db: Connection, actor: Actor, settings: Settings) -> bool:
    """Whether the actor can sign in without a provider: with a password, or as the owner with a link."""
    if actor.person_id == OWNER_ID and settings.owner_token_file is not None:
        return True
    has_address = (await db.execute(_addresses(actor))).first() is not None
    return has_address and await _has_password(db, actor, settings)


def _to_read(
    row: _Identity, linked: Sequence[_Identity], *, has_other_method: bool, settings: Settings
) -> IdentityRead:
    titles = {provider.issuer: provider.title for provider in settings.oidc_providers}
    # Identities of providers that left the settings no longer work.
    others = [other for other in linked if other.id != row.id and other.issuer in titles]
    return IdentityRead(
        id=row.id,
        issuer=row.issuer,
        provider=titles.get(row.issuer),
        is_last=not has_other_method and not others,
        email=row.email,
        created_at=row.created_at,
        last_used_at=row.last_used_at,
    )
