"""Browser sessions: every sign-in starts a new one; people list and end theirs."""

import datetime
import secrets
import uuid
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import ColumnElement, Row, func, insert, select, update

from kleinkram.contract.accounts import SessionRead
from kleinkram.contract.base import Page
from kleinkram.contract.errors import NotFound, SignInRefused
from kleinkram.server.access.actor import Actor, find_person, secret_hash
from kleinkram.server.access.rights import ensure_active_person
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.settings import Settings
from kleinkram.server.tables import identity, session

_SESSION_ORDER = Order([session.c.created_at, session.c.id], descending=True)
_SECRET_BYTES = 32
_MAX_USER_AGENT_CHARACTERS = 300


@dataclass(frozen=True)
class Browser:
    """A browser that signs in, and the secret of its previous session."""

    user_agent: str | None
    previous_secret: str | None


@dataclass(frozen=True)
class SignInMethod:
    """How somebody signed in: `name` is `password`, `link`, `bootstrap`, or the URL of an issuer.

    With a provider, also the account there, and the id that the provider gave its own session.
    """

    name: str
    identity_id: uuid.UUID | None = None
    provider_session_id: str | None = None


@dataclass(frozen=True)
class NewSession:
    """A new session: the signed-in person, and the secret for the browser's cookie."""

    actor: Actor
    secret: str


async def start_session(
    db: Connection, guest: Actor, *, person_id: uuid.UUID, method: SignInMethod, browser: Browser, lifetime_s: float
) -> NewSession:
    """Sign a browser in with a new secret and end its previous session. Raises SignInRefused or NotAuthenticated."""
    person = await find_person(db, person_id)
    if person is None:
        raise SignInRefused(reason="this account is deactivated. Ask an admin of this server.")
    await ensure_active_person(db, person_id)
    session_id, secret = uuid.uuid4(), secrets.token_urlsafe(_SECRET_BYTES)
    actor = replace(
        person,
        session_id=session_id,
        operation=guest.operation,
        request_id=guest.request_id,
        address=guest.address,
    )
    await db.execute(
        insert(session).values(
            id=session_id,
            person_id=person_id,
            secret_sha256=secret_hash(secret),
            method=method.name,
            identity_id=method.identity_id,
            provider_session_id=method.provider_session_id,
            address=guest.address,
            user_agent=(browser.user_agent or "")[:_MAX_USER_AGENT_CHARACTERS] or None,
            expires_at=func.now() + datetime.timedelta(seconds=lifetime_s),
        )
    )
    await audit(db, actor, Event("session.create", "session", session_id, person.name, after={"method": method.name}))
    if browser.previous_secret:
        await _end(db, actor, session.c.secret_sha256 == secret_hash(browser.previous_secret))
    return NewSession(actor, secret)


async def renew_session(db: Connection, actor: Actor, *, method: str) -> None:
    """Record that the person has just reauthenticated in this session."""
    stmt = update(session).where(session.c.id == actor.session_id)
    await db.execute(stmt.values(authenticated_at=func.now()))
    await audit(db, actor, Event("session.renew", "session", actor.session_id, actor.name, after={"method": method}))


async def list_sessions(db: Connection, actor: Actor, *, settings: Settings, page: PageRequest) -> Page[SessionRead]:
    """Return a page of the actor's sessions, latest first. Raises InvalidCursor."""
    idle_timeout = datetime.timedelta(seconds=settings.session_idle_s)
    ends = [session.c.expires_at, session.c.last_used_at + idle_timeout]
    if settings.provider_session_days:  # null, and ignored by `least`, without a provider
        ends.append(identity.c.confirmed_at + datetime.timedelta(days=settings.provider_session_days))
    ends_at = func.least(*ends).label("ends_at")
    is_live = session.c.revoked_at.is_(None) & (ends_at > func.now())
    own_sessions = select(session, ends_at).outerjoin(identity, identity.c.id == session.c.identity_id)
    own_sessions = own_sessions.where(session.c.person_id == actor.person_id, is_live)

    def read(row: Row[Any]) -> SessionRead:
        values = {name: value for name, value in row._mapping.items() if name in SessionRead.model_fields}
        return SessionRead.model_validate(
            {**values, "expires_at": row.ends_at, "is_current": row.id == actor.session_id}
        )

    return await read_page(db, own_sessions, _SESSION_ORDER, page, read)


async def end_session(db: Connection, actor: Actor, *, session_id: uuid.UUID) -> None:
    """End one of the actor's sessions. Raises NotFound."""
    is_own = (session.c.person_id == actor.person_id) & (session.c.id == session_id)
    if not await _end(db, actor, is_own):
        raise NotFound(resource_type="session", ref=str(session_id))


async def end_sessions(db: Connection, actor: Actor, *, except_session_id: uuid.UUID | None = None) -> int:
    """End all sessions of the actor, except one if given; returns the number."""
    is_own = session.c.person_id == actor.person_id
    return await _end(db, actor, is_own if except_session_id is None else is_own & (session.c.id != except_session_id))


async def _end(db: Connection, actor: Actor, condition: ColumnElement[bool]) -> int:
    stmt = update(session).where(condition, session.c.revoked_at.is_(None)).values(revoked_at=func.now())
    session_ids = (await db.execute(stmt.returning(session.c.id))).scalars().all()
    await audit(db, actor, *(Event("session.revoke", "session", session_id, actor.name) for session_id in session_ids))
    return len(session_ids)
