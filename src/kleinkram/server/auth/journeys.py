"""A browser's way to a provider and back: begun here, bound to that browser, good once and for some minutes."""

import datetime
import secrets
import uuid
from dataclasses import dataclass, field

from sqlalchemy import delete, func, insert

from kleinkram.contract.errors import SignInRefused
from kleinkram.server.access.actor import secret_hash
from kleinkram.server.auth.providers import Challenge
from kleinkram.server.db import Connection
from kleinkram.server.tables import oidc_login

JOURNEY_S = 600
_SECRET_BYTES = 32


@dataclass(frozen=True)
class Journey:
    """What is kept of the way out; `session_id` is of who does not sign in, but links an identity to their account."""

    challenge: Challenge
    session_id: uuid.UUID | None
    return_to: str
    # Nothing is linked: whoever is signed in proves once more who they are.
    renews: bool = False


@dataclass(frozen=True)
class Ticket:
    """What the browser shows on the way back: in the address, and in a cookie."""

    state: str = field(repr=False)
    browser: str = field(repr=False)


def new_journey(return_to: str, *, session_id: uuid.UUID | None = None, renews: bool = False) -> Journey:
    """Return a way to begin, with fresh secrets."""
    challenge = Challenge(*(secrets.token_urlsafe(_SECRET_BYTES) for _ in range(3)))
    return Journey(challenge, session_id, return_to, renews)


async def begin_journey(db: Connection, *, provider: str, journey: Journey, browser: str) -> None:
    """Keep what the way back is compared with."""
    await db.execute(delete(oidc_login).where(oidc_login.c.expires_at < func.now()))
    await db.execute(
        insert(oidc_login).values(
            state_sha256=secret_hash(journey.challenge.state),
            provider=provider,
            nonce=journey.challenge.nonce,
            code_verifier=journey.challenge.code_verifier,
            browser_sha256=secret_hash(browser),
            session_id=journey.session_id,
            renews=journey.renews,
            return_to=journey.return_to,
            expires_at=func.now() + datetime.timedelta(seconds=JOURNEY_S),
        )
    )


async def end_journey(db: Connection, *, provider: str, ticket: Ticket) -> Journey:
    """Return what was kept, and keep it no longer: a second way back with the same state finds nothing.

    Raises:
        SignInRefused: this browser did not begin it, it was ended before, or it is too long ago.
    """
    same = (
        oidc_login.c.state_sha256 == secret_hash(ticket.state),
        oidc_login.c.browser_sha256 == secret_hash(ticket.browser),
        oidc_login.c.provider == provider,
        oidc_login.c.expires_at > func.now(),
    )
    row = (await db.execute(delete(oidc_login).where(*same).returning(*oidc_login.c))).one_or_none()
    if row is None:
        raise SignInRefused(
            reason="this sign-in was not begun in this browser, was finished before, or is too long ago. Begin again."
        )
    challenge = Challenge(ticket.state, row.nonce, row.code_verifier)
    return Journey(challenge, row.session_id, row.return_to, row.renews)
