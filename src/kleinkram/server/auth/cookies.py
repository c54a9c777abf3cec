"""Cookies of signing in: that of the session, and the one that binds the way back from a provider to its browser.

With TLS they carry `__Host-`, so that no other host, and nobody on the way without TLS, can set them.
"""

import re
import secrets

from fastapi import Request, Response

from kleinkram.server.auth.journeys import JOURNEY_S
from kleinkram.server.auth.sessions import Browser
from kleinkram.server.http.dependencies import session_cookie
from kleinkram.server.settings import Settings

_SECRET = re.compile(r"[A-Za-z0-9_-]{43}")


def browser_of(request: Request, settings: Settings) -> Browser:
    """Return what is known of the browser that asks."""
    return Browser(request.headers.get("user-agent"), request.cookies.get(session_cookie(settings)))


def keep_session(response: Response, settings: Settings, secret: str) -> None:
    """Give a browser its session."""
    _set(response, settings, session_cookie(settings), secret, lasts_s=settings.session_s)


def drop_session(response: Response, settings: Settings) -> None:
    """Take its session from a browser."""
    _set(response, settings, session_cookie(settings), "", lasts_s=0)


def bind_browser(request: Request, response: Response, settings: Settings) -> str:
    """Return a secret that only this browser brings back; one that it has already stays, for its other tabs."""
    held = request.cookies.get(_journey_cookie(settings), "")
    secret = held if _SECRET.fullmatch(held) else secrets.token_urlsafe(32)
    _set(response, settings, _journey_cookie(settings), secret, lasts_s=JOURNEY_S)
    return secret


def bound_browser(request: Request, settings: Settings) -> str:
    """Return the secret that `bind_browser` gave, or nothing where the browser does not bring it."""
    return request.cookies.get(_journey_cookie(settings), "")


def _journey_cookie(settings: Settings) -> str:
    return f"{session_cookie(settings)}-journey"


def _set(response: Response, settings: Settings, name: str, value: str, *, lasts_s: float) -> None:
    response.set_cookie(
        name,
        value,
        max_age=int(lasts_s),
        path="/",
        secure=settings.public_url.startswith("https://"),
        httponly=True,
        samesite="lax",
    )
