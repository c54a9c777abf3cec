"""One's own account: what one is known by here, and by which ways one signs in.

Nobody locks themselves out: of the ways that work today one stays. Unlinking ends nothing else: sessions, tokens and
addresses are as they were, and whoever wants those ended too says so.
"""

import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import Row, Select, exists, func, select, update

from kleinkram.contract.accounts import AccountRead, AddressRead, IdentityRead
from kleinkram.contract.errors import LastSignInMethod, NotAuthenticated, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.rights import GroupKind
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.access.groups import OWNER_ID
from kleinkram.server.access.rights import lock_person
from kleinkram.server.audit.service import Event, record
from kleinkram.server.auth.totp import read_totp
from kleinkram.server.db import Connection
from kleinkram.server.settings import Settings
from kleinkram.server.tables import access_group, identity, membership, password, person, person_email


async def get_account(db: Connection, actor: Actor, *, settings: Settings) -> AccountRead:
    """Return one's own account.

    Raises:
        NotAuthenticated: nobody with an account.
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
    """Return under whose word somebody signs in, in the order in which they were added."""
    rows = (await db.execute(_linked(actor))).all()
    has_other_way = await _has_other_way(db, actor, settings)
    return [_to_read(row, rows, has_other_way=has_other_way, settings=settings) for row in rows]


async def unlink_identity(db: Connection, actor: Actor, *, identity_id: uuid.UUID, settings: Settings) -> None:
    """Take a provider's word for oneself no more: what it calls one opens this account only once it is linked again.

    Raises:
        NotFound: none of one's own has that id.
        LastSignInMethod: without it there would be no way to sign in.
    """
    if actor.person_id is not None:
        # Of two at once that would each leave the other, one waits, and finds itself the last.
        await lock_person(db, actor.person_id)
    wanted = next(
        (each for each in await list_identities(db, actor, settings=settings) if each.id == identity_id), None
    )
    if wanted is None:
        raise NotFound(noun="identity", ref=str(identity_id))
    name = wanted.provider or wanted.issuer
    if wanted.is_last:
        raise LastSignInMethod(provider=name)
    await db.execute(update(identity).where(identity.c.id == identity_id).values(unlinked_at=func.now()))
    before: Metadata = {"issuer": wanted.issuer, "email": wanted.email, "person_id": str(actor.person_id)}
    await record(db, actor, Event("identity.unlink", "identity", identity_id, name, None, before=before))


def _linked(actor: Actor) -> Select[Any]:
    own = (identity.c.person_id == actor.person_id) & identity.c.unlinked_at.is_(None)
    return select(identity).where(own).order_by(identity.c.created_at, identity.c.id)


def _addresses(actor: Actor) -> Select[Any]:
    verified = (person_email.c.person_id == actor.person_id) & person_email.c.verified_at.is_not(None)
    return select(person_email).where(verified).order_by(person_email.c.email_key)


async def _has_password(db: Connection, actor: Actor, settings: Settings) -> bool:
    kept = exists().where(password.c.person_id == actor.person_id)
    return settings.local_accounts and bool((await db.execute(select(kept))).scalar_one())


async def _has_other_way(db: Connection, actor: Actor, settings: Settings) -> bool:
    """Say whether somebody gets in without any provider: with address and password, or by the owner's link."""
    if actor.person_id == OWNER_ID and settings.owner_token_file is not None:
        return True
    has_address = (await db.execute(_addresses(actor))).first() is not None
    return has_address and await _has_password(db, actor, settings)


def _to_read(row: Row[Any], linked: Sequence[Row[Any]], *, has_other_way: bool, settings: Settings) -> IdentityRead:
    titles = {each.issuer: each.title for each in settings.oidc_providers}
    # One of a provider that is gone from the settings lets nobody in.
    others = [each for each in linked if each.id != row.id and each.issuer in titles]
    return IdentityRead(
        id=row.id,
        issuer=row.issuer,
        provider=titles.get(row.issuer),
        is_last=not has_other_way and not others,
        email=row.email,
        created_at=row.created_at,
        last_used_at=row.last_used_at,
    )
