"""Who the server takes the caller for, and by what credential."""

from sqlalchemy import select

from kleinkram.contract.errors import NotAuthenticated
from kleinkram.contract.rights import GroupKind, Scope
from kleinkram.contract.signing_in import CredentialKind, CredentialRead, MeRead
from kleinkram.server.access.actor import Actor, ActorKind, unexpired
from kleinkram.server.db import Connection
from kleinkram.server.tables import access_group, membership, person_email, session, token


async def get_me(db: Connection, actor: Actor) -> MeRead:
    """Return who asks, and what their credential is good for.

    Addresses and groups are told to people alone: a robot's or a runner's token may be lost with its machine.

    Raises:
        NotAuthenticated: nobody with an account.
    """
    if actor.ref is None:
        raise NotAuthenticated(reason="this requires an account")
    is_oneself = actor.limits is None and actor.kind is ActorKind.person
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
        emails=sorted((await db.execute(emails)).scalars()) if is_oneself else [],
        groups=sorted((await db.execute(groups)).scalars()) if is_oneself else [],
        is_admin=actor.is_admin and Scope.admin in actor.scopes,
        credential=await _credential(db, actor),
    )


async def _credential(db: Connection, actor: Actor) -> CredentialRead:
    if actor.token_id is not None:
        held = (await db.execute(select(token).where(token.c.id == actor.token_id))).one()
        return CredentialRead(
            id=held.id,
            kind=CredentialKind(held.kind),
            name=held.name,
            scopes=[Scope(scope) for scope in held.scopes],
            is_limited=held.is_limited,
            expires_at=held.expires_at,
        )
    row = (await db.execute(select(session).where(session.c.id == actor.session_id))).one()
    return CredentialRead(
        id=row.id,
        kind=CredentialKind.session,
        name=row.way,
        scopes=sorted(actor.scopes),
        is_limited=False,
        expires_at=row.expires_at,
    )
