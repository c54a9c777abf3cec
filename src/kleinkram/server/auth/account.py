"""A person's own account: who they are, their addresses, and the identities with which they sign in."""

import uuid
from typing import Any

from sqlalchemy import Select, exists, func, select, update

from kleinkram.contract import accounts, errors
from kleinkram.contract.access import GroupKind, Scope
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor, ActorKind, unexpired
from kleinkram.server.access.builtin_groups import OWNER_ID
from kleinkram.server.access.rights import lock_person
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.auth.second_factor import read_totp
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings
from kleinkram.server.tables import access_group, identity, membership, password, person, person_email, session, token


async def get_me(db: Connection, actor: Actor) -> accounts.MeRead:
    """Return the actor and their credential.

    Addresses and groups are left out for tokens of robots and runners, which may be lost with their machine.

    Raises NotAuthenticated.
    """
    if actor.ref is None:
        raise errors.NotAuthenticated(reason="this requires an account")
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
    return accounts.MeRead(
        person=actor.ref,
        emails=sorted((await db.execute(emails)).scalars()) if is_person else [],
        groups=sorted((await db.execute(groups)).scalars()) if is_person else [],
        is_admin=actor.is_admin and Scope.admin in actor.scopes,
        credential=await _get_credential(db, actor),
    )


async def _get_credential(db: Connection, actor: Actor) -> accounts.CredentialRead:
    if actor.token_id is not None:
        row = (await db.execute(select(token).where(token.c.id == actor.token_id))).one()
        kind, name, scopes, is_limited = (
            accounts.CredentialKind(row.kind),
            row.name,
            [Scope(scope) for scope in row.scopes],
            row.is_limited,
        )
    else:
        row = (await db.execute(select(session).where(session.c.id == actor.session_id))).one()
        kind, name, scopes, is_limited = accounts.CredentialKind.session, row.method, sorted(actor.scopes), False
    return accounts.CredentialRead(
        id=row.id, kind=kind, name=name, scopes=scopes, is_limited=is_limited, expires_at=row.expires_at
    )


async def get_account(db: Connection, actor: Actor, *, settings: Settings) -> accounts.AccountRead:
    """Return the actor's account. Raises NotAuthenticated."""
    if actor.ref is None:
        raise errors.NotAuthenticated(reason="this requires an account")
    created_at = (await db.execute(select(person.c.created_at).where(person.c.id == actor.person_id))).scalar_one()
    groups = select(access_group.c.name).join_from(membership, access_group)
    is_own = (membership.c.person_id == actor.person_id) & unexpired(membership.c.expires_at)
    affiliations = groups.where(is_own, access_group.c.kind == GroupKind.affiliation.value)
    return accounts.AccountRead(
        person=actor.ref,
        addresses=[
            accounts.AddressRead(email=row.email, verified_at=row.verified_at, verified_by=row.verified_by)
            for row in await db.execute(_addresses(actor))
        ],
        affiliations=sorted((await db.execute(affiliations)).scalars()),
        has_password=await _may_use_password(db, actor, settings),
        totp=await read_totp(db, actor.person_id),
        created_at=created_at,
    )


async def list_identities(db: Connection, actor: Actor, *, settings: Settings) -> list[accounts.IdentityRead]:
    """Return the actor's linked identities in the order in which they were linked."""
    linked = (identity.c.person_id == actor.person_id) & identity.c.unlinked_at.is_(None)
    stmt = select(identity).where(linked).order_by(identity.c.created_at, identity.c.id)
    rows = (await db.execute(stmt)).all()
    # Without a provider, people sign in with a password, and the owner with a link.
    has_other_method = actor.person_id == OWNER_ID and settings.owner_token_file is not None
    if not has_other_method and (await db.execute(_addresses(actor))).first() is not None:
        has_other_method = await _may_use_password(db, actor, settings)
    titles = {provider.issuer: provider.title for provider in settings.oidc_providers}
    # Identities of providers that left the settings no longer work.
    usable_ids = {row.id for row in rows if row.issuer in titles}
    return [
        accounts.IdentityRead(
            id=row.id,
            issuer=row.issuer,
            provider=titles.get(row.issuer),
            is_last=not has_other_method and not usable_ids - {row.id},
            email=row.email,
            created_at=row.created_at,
            last_used_at=row.last_used_at,
        )
        for row in rows
    ]


async def unlink_identity(db: Connection, actor: Actor, *, identity_id: uuid.UUID, settings: Settings) -> None:
    """Unlink an identity, so that it no longer opens the account. Raises NotFound or LastSignInMethod."""
    if actor.person_id is not None:
        # Serializes concurrent requests, which could otherwise unlink all identities.
        await lock_person(db, actor.person_id)
    identities = await list_identities(db, actor, settings=settings)
    unlinked = next((candidate for candidate in identities if candidate.id == identity_id), None)
    if unlinked is None:
        raise errors.NotFound(resource_type="identity", ref=str(identity_id))
    name = unlinked.provider or unlinked.issuer
    if unlinked.is_last:
        raise errors.LastSignInMethod(provider=name)
    await db.execute(update(identity).where(identity.c.id == identity_id).values(unlinked_at=func.now()))
    before: Metadata = {"issuer": unlinked.issuer, "email": unlinked.email, "person_id": str(actor.person_id)}
    await audit(db, actor, Event("identity.unlink", "identity", identity_id, name, before=before))


def _addresses(actor: Actor) -> Select[Any]:
    verified = (person_email.c.person_id == actor.person_id) & person_email.c.verified_at.is_not(None)
    return select(person_email).where(verified).order_by(person_email.c.email_key)


async def _may_use_password(db: Connection, actor: Actor, settings: Settings) -> bool:
    has_password = exists().where(password.c.person_id == actor.person_id)
    return settings.local_accounts and bool((await db.execute(select(has_password))).scalar_one())
