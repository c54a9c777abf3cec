"""Sessions of browsers: begun anew by every sign-in, listed, and ended."""

import datetime
import secrets
import uuid
from dataclasses import dataclass, replace

from sqlalchemy import ColumnElement, func, insert, select, update

from kleinkram.contract.errors import NotFound, SignInRefused
from kleinkram.contract.paging import Page
from kleinkram.contract.signing_in import SessionRead
from kleinkram.server.access.actor import Actor, find_person, secret_hash
from kleinkram.server.access.rights import ensure_active_person
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection
from kleinkram.server.paging import Order, PageRequest, fetch_page
from kleinkram.server.settings import Settings
from kleinkram.server.tables import session

SESSION_ORDER = Order([session.c.created_at, session.c.id], descending=True)
_SECRET_BYTES = 32
_MOST_CHARACTERS = 300


@dataclass(frozen=True)
class Browser:
    """What is known of a browser that signs in: `held` is the secret of the session that it had until now."""

    user_agent: str | None
    held: str | None


@dataclass(frozen=True)
class NewSession:
    """A session just begun: whose, and the secret for the browser's cookie."""

    actor: Actor
    secret: str


async def begin_session(
    db: Connection, asker: Actor, *, person_id: uuid.UUID, way: str, browser: Browser, lasts_s: float
) -> NewSession:
    """Sign a browser in, under a new secret; what it was signed in as before ends.

    Raises:
        SignInRefused: that person left.
        NotAuthenticated: they left just now.
    """
    found = await find_person(db, person_id)
    if found is None:
        raise SignInRefused(reason="this account was deactivated. An admin of this server can say why.")
    await ensure_active_person(db, person_id)
    session_id, secret = uuid.uuid4(), secrets.token_urlsafe(_SECRET_BYTES)
    actor = replace(
        found,
        session_id=session_id,
        operation=asker.operation,
        request_id=asker.request_id,
        address=asker.address,
    )
    await db.execute(
        insert(session).values(
            id=session_id,
            person_id=person_id,
            secret_sha256=secret_hash(secret),
            way=way,
            address=asker.address,
            user_agent=(browser.user_agent or "")[:_MOST_CHARACTERS] or None,
            expires_at=func.now() + datetime.timedelta(seconds=lasts_s),
        )
    )
    await record(db, actor, Event("session.create", "session", session_id, found.name, None, after={"way": way}))
    if browser.held:
        await _end(db, actor, session.c.secret_sha256 == secret_hash(browser.held))
    return NewSession(actor, secret)


async def renew_session(db: Connection, actor: Actor, *, way: str) -> None:
    """Note that whoever is signed in by this browser has just proven once more who they are."""
    mine = update(session).where(session.c.id == actor.session_id)
    await db.execute(mine.values(authenticated_at=func.now()))
    await record(db, actor, Event("session.renew", "session", actor.session_id, actor.name, None, after={"way": way}))


async def list_sessions(db: Connection, actor: Actor, *, settings: Settings, page: PageRequest) -> Page[SessionRead]:
    """Return a page of the browsers that somebody is signed in with, latest first.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    idle = datetime.timedelta(seconds=settings.session_idle_s)
    ends = func.least(session.c.expires_at, session.c.last_used_at + idle).label("ends_at")
    is_live = session.c.revoked_at.is_(None) & (ends > func.now())
    own = select(session, ends).where(session.c.person_id == actor.person_id, is_live)
    rows = await fetch_page(db, own, SESSION_ORDER, page)
    items = [
        SessionRead(
            id=row.id,
            way=row.way,
            address=row.address,
            user_agent=row.user_agent,
            created_at=row.created_at,
            last_used_at=row.last_used_at,
            expires_at=row.ends_at,
            is_current=row.id == actor.session_id,
        )
        for row in rows.items
    ]
    return Page(items=items, next=rows.next, total=rows.total)


async def end_session(db: Connection, actor: Actor, *, session_id: uuid.UUID) -> None:
    """Sign one of one's own browsers out.

    Raises:
        NotFound: none of one's own, that is still signed in, has that id.
    """
    own = (session.c.person_id == actor.person_id) & (session.c.id == session_id)
    if not await _end(db, actor, own):
        raise NotFound(noun="session", ref=str(session_id))


async def end_sessions(db: Connection, actor: Actor, *, besides: uuid.UUID | None = None) -> int:
    """Sign all of one's browsers out, except one where that is wanted; returns how many that were."""
    own = session.c.person_id == actor.person_id
    return await _end(db, actor, own if besides is None else own & (session.c.id != besides))


async def _end(db: Connection, actor: Actor, which: ColumnElement[bool]) -> int:
    stmt = update(session).where(which, session.c.revoked_at.is_(None)).values(revoked_at=func.now())
    ended = (await db.execute(stmt.returning(session.c.id))).scalars().all()
    await record(db, actor, *(Event("session.revoke", "session", each, actor.name, None) for each in ended))
    return len(ended)
