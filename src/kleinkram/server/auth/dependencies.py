"""Dependencies of sign-in routes: limits on attempts, password hashing, identity providers, and cookies.

With TLS, cookies have the prefix `__Host-`, so that neither other hosts nor connections without TLS can set them.
"""

import asyncio
import re
import secrets
import uuid
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from fastapi import Depends, Request, Response

from kleinkram.contract.accounts import BrowserSignedIn
from kleinkram.contract.errors import NotFound
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.auth.local_accounts import PasswordHasher
from kleinkram.server.auth.one_time_codes import describe_code
from kleinkram.server.auth.provider_accounts import REQUEST_LIFETIME_S
from kleinkram.server.auth.sessions import Browser, SignInMethod, start_session
from kleinkram.server.db import Connection, Database
from kleinkram.server.http.dependencies import CurrentActor, CurrentDatabase, CurrentSettings, session_cookie
from kleinkram.server.http.rate_limit import Count, enforce_limits, reserve_slot, subscriber_network
from kleinkram.server.settings import Settings

if TYPE_CHECKING:
    from kleinkram.server.auth.oidc import OpenIdProvider

# An account may be tried this many times as often as one address may try, before attempts must wait for slots.
_ADDRESSES_PER_ACCOUNT = 3
# As many as a lab has browsers; each costs the check of a signature.
_PROVIDER_LOGOUTS_PER_MINUTE = 600
# 32 random bytes.
_BROWSER_SECRET = re.compile(r"[A-Za-z0-9_-]{43}")


@dataclass(frozen=True)
class SignInContext:
    """One request that signs a browser in, and the resources it needs."""

    actor: Actor
    request: Request
    database: Database
    settings: Settings

    @property
    def hasher(self) -> PasswordHasher:
        """The password hasher of this process."""
        hasher: PasswordHasher = self.request.app.state.password_hasher
        return hasher

    def provider(self, name: str) -> "OpenIdProvider":
        """Return an identity provider. Raises NotFound."""
        providers: dict[str, OpenIdProvider] = self.request.app.state.providers
        if name not in providers:
            raise NotFound(resource_type="provider", ref=name)
        return providers[name]

    async def count_attempt(self, account: str | None = None) -> None:
        """Count an attempt for the client's address and for the account, whether it exists or not.

        Too many attempts from an address are refused; too many on an account only wait, so that it cannot be locked.

        Raises RateLimited.
        """
        limit = self.settings.sign_ins_per_minute
        if self.actor.address:
            await enforce_limits(self.database, Count("sign-ins", subscriber_network(self.actor.address), limit))
        if account:
            count = Count("sign-ins", account.lower(), _ADDRESSES_PER_ACCOUNT * limit)
            await asyncio.sleep(await reserve_slot(self.database, count))

    async def count_provider_logout(self) -> None:
        """Count a logout token for the client's address: a provider sends many at once. Raises RateLimited."""
        if self.actor.address:
            client = subscriber_network(self.actor.address)
            await enforce_limits(self.database, Count("logouts by providers", client, _PROVIDER_LOGOUTS_PER_MINUTE))

    async def hash_with_code(self, password: str, *, code: str, about: tuple[str | None, ...] = ()) -> str:
        """Hash a new password, if a one-time code is valid; the code is not used up.

        Raises CodeGone, InvalidRequest or SlowDown.
        """
        async with self.database.begin() as db:
            recipient = await describe_code(db, code)
        return await self.hash_new(password, field="password", about=(recipient.name, recipient.email, *about))

    async def hash_new(self, password: str, *, field: str, about: tuple[str | None, ...]) -> str:
        """Hash a newly chosen password. Raises InvalidRequest or SlowDown."""
        return await self.hasher.hash_new(password, field=field, about=(*about, self.settings.lab_name))

    async def start_session(
        self, db: Connection, response: Response, *, person_id: uuid.UUID, method: str | SignInMethod
    ) -> BrowserSignedIn:
        """Sign the browser in, as part of the caller's transaction. Raises SignInRefused."""
        method = SignInMethod(method) if isinstance(method, str) else method
        cookie = session_cookie(self.settings)
        browser = Browser(self.request.headers.get("user-agent"), self.request.cookies.get(cookie))
        session = await start_session(
            db, self.actor, person_id=person_id, method=method, browser=browser, lifetime_s=self.settings.session_s
        )
        _set_cookie(response, self.settings, cookie, session.secret, lifetime_s=self.settings.session_s)
        return BrowserSignedIn(person=PersonRef(id=person_id, name=session.actor.name))

    def require_local_accounts(self) -> None:
        """Check that this server has local accounts. Raises NotFound."""
        if not self.settings.local_accounts:
            raise NotFound(resource_type="sign-in method", ref="password")


async def _sign_in_context(
    request: Request, database: CurrentDatabase, settings: CurrentSettings, actor: CurrentActor
) -> SignInContext:
    return SignInContext(actor, request, database, settings)


CurrentSignIn = Annotated[SignInContext, Depends(_sign_in_context)]


def delete_session_cookie(response: Response, settings: Settings) -> None:
    """Delete the session cookie of a browser."""
    _set_cookie(response, settings, session_cookie(settings), "", lifetime_s=0)


def bind_browser(request: Request, response: Response, settings: Settings) -> str:
    """Return a secret that only this browser sends back; an existing one is kept for the browser's other tabs."""
    secret = bound_browser(request, settings)
    if not _BROWSER_SECRET.fullmatch(secret):
        secret = secrets.token_urlsafe(32)
    _set_cookie(response, settings, _cookie_name(settings), secret, lifetime_s=REQUEST_LIFETIME_S)
    return secret


def bound_browser(request: Request, settings: Settings) -> str:
    """Return the secret from `bind_browser`; empty if the browser does not send it."""
    return request.cookies.get(_cookie_name(settings), "")


def _cookie_name(settings: Settings) -> str:
    return f"{session_cookie(settings)}-authorization"


def _set_cookie(response: Response, settings: Settings, name: str, value: str, *, lifetime_s: float) -> None:
    """Set a cookie that no script can read, over TLS only if the server uses TLS."""
    response.set_cookie(
        name,
        value,
        max_age=int(lifetime_s),
        path="/",
        secure=settings.public_url.startswith("https://"),
        httponly=True,
        samesite="lax",
    )
