"""What every provider of identities does, whatever it speaks: OpenID Connect is in `oidc`, others go beside it.

A provider says who somebody is. Who that is to us, and whether its word on an address counts, `accounts` decides.
"""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Protocol

from kleinkram.contract.errors import NotFound
from kleinkram.server.settings import OidcProvider, Settings


@dataclass(frozen=True)
class Vouched:
    """Whom a provider vouches for. `email_verified` is its own claim, whoever trusts it."""

    issuer: str
    subject: str
    email: str | None
    email_verified: bool
    name: str | None
    # When they last gave their password there, where the provider says so: seconds since 1970, by its clock.
    auth_time: int | None = None


@dataclass(frozen=True)
class Challenge:
    """What binds the way back to the way out. `state` travels by the browser, the rest stays here."""

    state: str = field(repr=False)
    nonce: str = field(repr=False)
    code_verifier: str = field(repr=False)


class Provider(Protocol):
    """Somebody who says who people are."""

    @property
    def settings(self) -> OidcProvider:
        """What the server's settings say of it."""
        ...

    async def authorization_url(self, challenge: Challenge, *, again: bool = False) -> str:
        """Return where the browser goes; `again` asks for the password even of somebody who is signed in there.

        Raises:
            ProviderUnavailable: the provider does not answer.
        """
        ...

    async def vouch(self, code: str, challenge: Challenge) -> Vouched:
        """Return whom the browser came back as, with the code that it brought.

        Raises:
            ProviderUnavailable: the provider does not answer.
            SignInRefused: it does not know the code, or what it says cannot be believed.
        """
        ...


class Providers:
    """The providers of one process, by name."""

    def __init__(self, providers: Mapping[str, Provider]) -> None:
        self._providers = providers

    def get(self, name: str) -> Provider:
        """Return a provider.

        Raises:
            NotFound: none has that name.
        """
        if name not in self._providers:
            raise NotFound(noun="provider", ref=name)
        return self._providers[name]


def callback_url(settings: Settings, provider: str) -> str:
    """Return where a provider sends browsers back to: what is registered with it."""
    return f"{settings.public_url.rstrip('/')}/sign-in/callback/{provider}"


@asynccontextmanager
async def open_providers(settings: Settings) -> AsyncIterator[Providers]:
    """Make the providers that the settings name; none is asked before somebody signs in."""
    if not settings.oidc_providers:
        yield Providers({})
        return
    import httpx

    from kleinkram.server.auth.oidc import OpenIdProvider

    async with httpx.AsyncClient(follow_redirects=False) as web:
        made: dict[str, Provider] = {}
        for each in settings.oidc_providers:
            secret = await asyncio.to_thread(_read_secret, each)
            made[each.name] = OpenIdProvider(each, web, redirect_url=callback_url(settings, each.name), secret=secret)
        yield Providers(made)


def _read_secret(settings: OidcProvider) -> str | None:
    if settings.client_secret_file is not None:
        return settings.client_secret_file.read_text(encoding="utf-8").strip()
    return None if settings.client_secret is None else settings.client_secret.get_secret_value()
