"""Identity providers, and authorization requests: what is stored until a provider sends a browser back.

A request is bound to the browser by a cookie, is valid once, and expires after some minutes.
"""

import asyncio
import datetime
import re
import secrets
import uuid
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fastapi import Request, Response
from sqlalchemy import delete, func, insert

from kleinkram.contract.errors import NotFound, SignInRefused
from kleinkram.server.access.actor import secret_hash
from kleinkram.server.db import Connection
from kleinkram.server.http.dependencies import session_cookie
from kleinkram.server.settings import OidcProvider, Settings
from kleinkram.server.tables import oidc_login

if TYPE_CHECKING:
    from kleinkram.server.auth.oidc import OpenIdProvider

_LIFETIME_S = 600
_SECRET_BYTES = 32
_SECRET = re.compile(r"[A-Za-z0-9_-]{43}")


@dataclass(frozen=True)
class VerifiedIdentity:
    """The person that a provider vouches for. `email_verified` is the provider's claim."""

    issuer: str
    subject: str
    email: str | None
    email_verified: bool
    name: str | None
    # When they last entered their password there, if the provider tells: seconds since 1970, by its clock.
    auth_time: int | None = None


@dataclass(frozen=True)
class AuthorizationRequest:
    """One request; `state` travels through the browser, the other secrets stay on the server.

    With `session_id`, the signed-in person links an identity to their account or, with `reauthenticates`, proves who
    they are once more.
    """

    return_to: str
    session_id: uuid.UUID | None = None
    reauthenticates: bool = False
    state: str = field(default_factory=lambda: secrets.token_urlsafe(_SECRET_BYTES), repr=False)
    nonce: str = field(default_factory=lambda: secrets.token_urlsafe(_SECRET_BYTES), repr=False)
    code_verifier: str = field(default_factory=lambda: secrets.token_urlsafe(_SECRET_BYTES), repr=False)


class Providers:
    """The providers of one process, by name."""

    def __init__(self, providers: "Mapping[str, OpenIdProvider]") -> None:
        self._providers = providers

    def get(self, name: str) -> "OpenIdProvider":
        """Return a provider.

        Raises:
            NotFound: no provider has this name.
        """
        if name not in self._providers:
            raise NotFound(noun="provider", ref=name)
        return self._providers[name]


@asynccontextmanager
async def open_providers(settings: Settings) -> AsyncIterator[Providers]:
    """Open clients of the providers in the settings; a provider is contacted only when somebody signs in."""
    if not settings.oidc_providers:
        yield Providers({})
        return
    import aiohttp

    from kleinkram.server.auth.oidc import OpenIdProvider  # 10 MB with its libraries

    async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar(), trust_env=True) as http:
        providers: dict[str, OpenIdProvider] = {}
        for provider in settings.oidc_providers:
            secret = await asyncio.to_thread(_read_secret, provider)
            redirect_url = callback_url(settings, provider.name)
            providers[provider.name] = OpenIdProvider(provider, http, redirect_url=redirect_url, secret=secret)
        yield Providers(providers)


def callback_url(settings: Settings, provider: str) -> str:
    """Return the redirect URL that is registered with a provider."""
    return f"{settings.public_url.rstrip('/')}/sign-in/callback/{provider}"


def _read_secret(settings: OidcProvider) -> str | None:
    if settings.client_secret_file is not None:
        return settings.client_secret_file.read_text(encoding="utf-8").strip()
    return None if settings.client_secret is None else settings.client_secret.get_secret_value()


async def store_request(db: Connection, request: AuthorizationRequest, *, provider: str, browser_secret: str) -> None:
    """Store a request for its callback."""
    await db.execute(delete(oidc_login).where(oidc_login.c.expires_at < func.now()))
    await db.execute(
        insert(oidc_login).values(
            state_sha256=secret_hash(request.state),
            provider=provider,
            nonce=request.nonce,
            code_verifier=request.code_verifier,
            browser_sha256=secret_hash(browser_secret),
            session_id=request.session_id,
            reauthenticates=request.reauthenticates,
            return_to=request.return_to,
            expires_at=func.now() + datetime.timedelta(seconds=_LIFETIME_S),
        )
    )


async def take_request(db: Connection, *, provider: str, state: str, browser_secret: str) -> AuthorizationRequest:
    """Return and delete the request of a callback, so that a replayed callback finds nothing.

    Raises:
        SignInRefused: another browser started it, it was finished before, or it expired.
    """
    same = (
        oidc_login.c.state_sha256 == secret_hash(state),
        oidc_login.c.browser_sha256 == secret_hash(browser_secret),
        oidc_login.c.provider == provider,
        oidc_login.c.expires_at > func.now(),
    )
    row = (await db.execute(delete(oidc_login).where(*same).returning(*oidc_login.c))).one_or_none()
    if row is None:
        raise SignInRefused(
            reason="this sign-in was not started in this browser, was finished before, or has expired. Start again."
        )
    return AuthorizationRequest(
        row.return_to, row.session_id, row.reauthenticates, state, nonce=row.nonce, code_verifier=row.code_verifier
    )


def bind_browser(request: Request, response: Response, settings: Settings) -> str:
    """Return a secret that only this browser sends back; an existing one is kept for the browser's other tabs."""
    secret = bound_browser(request, settings)
    if not _SECRET.fullmatch(secret):
        secret = secrets.token_urlsafe(_SECRET_BYTES)
    set_cookie(response, settings, _cookie_name(settings), secret, lifetime_s=_LIFETIME_S)
    return secret


def bound_browser(request: Request, settings: Settings) -> str:
    """Return the secret from `bind_browser`; empty if the browser does not send it."""
    return request.cookies.get(_cookie_name(settings), "")


def _cookie_name(settings: Settings) -> str:
    return f"{session_cookie(settings)}-authorization"


def set_cookie(response: Response, settings: Settings, name: str, value: str, *, lifetime_s: float) -> None:
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
