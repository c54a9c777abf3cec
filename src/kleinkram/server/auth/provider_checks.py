"""What ends access when a provider ends it: checks of accounts by refresh tokens, and back-channel logout.

Browser sessions and the tokens of `klein login` depend on the account with which the person signed in. When the
provider refuses it, they end; other credentials stay until an admin deactivates the person. A logout at the provider
ends browser sessions alone, as it does not say that the account is gone; the account is checked soon after it.
"""

import datetime
import logging
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from sqlalchemy import ColumnElement, Table, Update, func, or_, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.access import TokenKind
from kleinkram.contract.errors import KleinkramError, ProviderUnavailable, SignInRefused
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor, unexpired
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.settings import OidcProvider
from kleinkram.server.tables import identity, person, session, token, used_logout_token

if TYPE_CHECKING:
    from kleinkram.server.auth.oidc import OpenIdProvider

_log = logging.getLogger("kleinkram.providers")
# Of each provider, in one round.
_BATCH = 200


class LogoutTokenInvalid(Exception):
    """A logout token is not accepted. The text says why."""


@dataclass(frozen=True)
class LogoutRequest:
    """The sessions that a provider wants to end: of a person, of one session of theirs, or both."""

    issuer: str
    provider: str
    subject: str | None
    session_id: str | None
    jti: str
    expires_at: datetime.datetime


@dataclass(frozen=True)
class RefreshedAccount:
    """A provider confirmed an account; its refresh token may be a new one."""

    refresh_token: str = field(repr=False)


class _Account(NamedTuple):
    id: uuid.UUID
    person_id: uuid.UUID
    subject: str
    refresh_token: str


async def forget_refresh_tokens(context: AppContext, *, except_issuers: Sequence[str]) -> None:
    """Delete the refresh tokens of providers that are not checked, such as those that left the settings."""
    is_checked = identity.c.issuer.in_(except_issuers) | identity.c.refresh_token.is_(None)
    async with context.database.begin() as db:
        await db.execute(update(identity).where(~is_checked).values(refresh_token=None))


async def end_provider_sessions(db: Connection, provider: Actor, *, logout: LogoutRequest) -> int:
    """End the sessions that a logout token names; returns their number. Raises LogoutTokenInvalid if it was used."""
    used = {"issuer": logout.issuer, "jti": logout.jti, "expires_at": logout.expires_at}
    stmt = upsert(used_logout_token).values(used).on_conflict_do_nothing()
    if (await db.execute(stmt.returning(used_logout_token.c.jti))).first() is None:
        raise LogoutTokenInvalid("the logout token was used before")
    accounts = select(identity.c.id).where(identity.c.issuer == logout.issuer)
    if logout.subject is not None:
        accounts = accounts.where(identity.c.subject == logout.subject)
        # The account may be gone.
        await db.execute(update(identity).where(identity.c.id.in_(accounts)).values(checked_at=None))
    is_named: ColumnElement[bool] = session.c.identity_id.in_(accounts)
    if logout.session_id is not None:
        is_same = session.c.provider_session_id == logout.session_id
        # Without an id in the sign-in, it may be any session of the person.
        is_named &= is_same if logout.subject is None else is_same | session.c.provider_session_id.is_(None)
    return await _end_sessions(db, provider, is_named, reason=f"logout at {logout.provider}")


async def check_accounts(context: AppContext, provider: "OpenIdProvider", *, limit: int = _BATCH) -> None:
    """Check the accounts of a provider whose check is due, and end the access of those that it refuses.

    If the provider fails, the rest waits for the next round. An account about which it does not answer properly waits
    for its next check, so that it does not delay the others.
    """
    for account in await _due_accounts(context, provider.settings, limit):
        try:
            refreshed = await provider.refresh(account.refresh_token, subject=account.subject)
        except ProviderUnavailable as error:
            _log_unchecked(provider.settings, account, error)
            return
        except SignInRefused as error:
            _log_unchecked(provider.settings, account, error)
            async with context.database.begin() as db:
                await db.execute(_unchanged(account).values(checked_at=func.now()))
            continue
        async with context.database.begin() as db:
            if refreshed is None:
                await _end_access(db, account, provider.settings)
            else:
                now = {"confirmed_at": func.now(), "checked_at": func.now()}
                await db.execute(_unchanged(account).values(**now, refresh_token=refreshed.refresh_token))


def _log_unchecked(provider: OidcProvider, account: _Account, error: KleinkramError) -> None:
    fields = {"provider": provider.name, "identity_id": str(account.id), "reason": str(error)}
    _log.warning("account not checked", extra={"fields": fields})


async def _due_accounts(context: AppContext, provider: OidcProvider, limit: int) -> Sequence[_Account]:
    """Return accounts to check, and forget the refresh tokens of those on which nothing depends any more."""
    interval = datetime.timedelta(hours=context.settings.provider_check_hours)
    of_provider = (identity.c.issuer == provider.issuer) & identity.c.refresh_token.is_not(None)
    sessions = select(session.c.identity_id).where(_is_live(session), session.c.identity_id.is_not(None))
    tokens = select(token.c.identity_id).where(_is_live(token), token.c.identity_id.is_not(None))
    is_needed = identity.c.id.in_(sessions) | identity.c.id.in_(tokens)
    is_due = or_(identity.c.checked_at.is_(None), identity.c.checked_at < func.now() - interval)
    columns = [identity.c[name] for name in _Account._fields]
    due = select(*columns).where(of_provider, is_due, is_needed)
    async with context.database.begin() as db:
        await db.execute(update(identity).where(of_provider, ~is_needed).values(refresh_token=None))
        rows = await db.execute(due.order_by(identity.c.checked_at.nulls_first()).limit(limit))
        return [_Account(*row) for row in rows]


async def _end_access(db: Connection, account: _Account, provider: OidcProvider) -> None:
    """End the sessions and tokens that depend on an account, unless the person has signed in with it meanwhile."""
    forgotten = await db.execute(_unchanged(account).values(checked_at=func.now(), refresh_token=None))
    if forgotten.rowcount == 0:
        return
    reason = f"account ended at {provider.title}"
    sessions = await _end_sessions(db, None, session.c.identity_id == account.id, reason=reason)
    # As when people revoke them, with those that were created with them; an admin decides about robots and runners.
    dependent = select(token.c.id).where(token.c.identity_id == account.id).cte("dependent_token", recursive=True)
    derived = select(token.c.id).join(dependent, token.c.created_by_token_id == dependent.c.id)
    dependent = dependent.union(derived.where(token.c.kind == TokenKind.personal.value))
    revoke = update(token).where(token.c.id.in_(select(dependent.c.id)), token.c.revoked_at.is_(None))
    rows = (await db.execute(revoke.values(revoked_at=func.now()).returning(token.c.id, token.c.name))).all()
    after: Metadata = {"person_id": str(account.person_id), "sessions": sessions, "tokens": len(rows)}
    events = [Event("token.revoke", "token", row.id, row.name, after={"reason": reason}) for row in rows]
    await audit(db, None, Event("identity.end_access", "identity", account.id, provider.title, after=after), *events)


async def _end_sessions(db: Connection, actor: Actor | None, condition: ColumnElement[bool], *, reason: str) -> int:
    stmt = update(session).where(condition, session.c.revoked_at.is_(None), person.c.id == session.c.person_id)
    rows = (await db.execute(stmt.values(revoked_at=func.now()).returning(session.c.id, person.c.name))).all()
    after: Metadata = {"reason": reason}
    await audit(db, actor, *(Event("session.revoke", "session", row.id, row.name, after=after) for row in rows))
    return len(rows)


def _unchanged(account: _Account) -> Update:
    same = (identity.c.id == account.id) & (identity.c.refresh_token == account.refresh_token)
    return update(identity).where(same)


def _is_live(table: Table) -> ColumnElement[bool]:
    return table.c.revoked_at.is_(None) & unexpired(table.c.expires_at)
