"""The identity providers in the settings, for API processes and workers."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from kleinkram.server.settings import Settings

if TYPE_CHECKING:
    from kleinkram.server.auth.oidc import OpenIdProvider


@asynccontextmanager
async def open_providers(settings: Settings) -> "AsyncIterator[dict[str, OpenIdProvider]]":
    """Open clients of the providers in the settings; a provider is contacted only when somebody signs in."""
    if not settings.oidc_providers:
        yield {}
        return
    import aiohttp

    from kleinkram.server.auth.oidc import OpenIdProvider  # 10 MB with its libraries

    async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar(), trust_env=True) as http:
        providers: dict[str, OpenIdProvider] = {}
        for provider in settings.oidc_providers:
            secret = None if provider.client_secret is None else provider.client_secret.get_secret_value()
            if provider.client_secret_file is not None:
                secret = (await asyncio.to_thread(provider.client_secret_file.read_text, encoding="utf-8")).strip()
            redirect_url = f"{settings.public_url.rstrip('/')}/sign-in/callback/{provider.name}"
            providers[provider.name] = OpenIdProvider(provider, http, redirect_url=redirect_url, secret=secret)
        yield providers
