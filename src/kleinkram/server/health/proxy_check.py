"""How a request reached the API, for `python -m kleinkram.server check` alone: inner addresses are not for strangers.

Whoever asks proves that it has the server's settings, by a code that is good for some minutes.
"""

import hashlib
import hmac
import time

from fastapi import Request
from pydantic import BaseModel, ConfigDict

from kleinkram.server.http.headers import is_trusted
from kleinkram.server.settings import Settings

HEADER = "X-Kleinkram-Check"
_GOOD_FOR_S = 300


class Seen(BaseModel):
    """What the API saw: `peer` connected to it; `address` and `scheme` are what it takes for the client's."""

    model_config = ConfigDict(frozen=True)

    peer: str
    is_trusted: bool
    forwarded: bool
    address: str
    scheme: str


def proof(settings: Settings, *, at_s: float | None = None) -> str:
    """Return a code that only who has these settings can make."""
    period = int((time.time() if at_s is None else at_s) // _GOOD_FOR_S)
    key = settings.s3_secret_key.get_secret_value().encode()
    return hmac.new(key, f"kleinkram check {period}".encode(), hashlib.sha256).hexdigest()


def seen(request: Request, settings: Settings) -> Seen | None:
    """Return how a request reached this process; None for who has no proof."""
    code = request.headers.get(HEADER, "")
    valid_codes = [proof(settings, at_s=time.time() - ago_s) for ago_s in (0, _GOOD_FOR_S)]
    if request.client is None or not any(hmac.compare_digest(code.encode(), valid.encode()) for valid in valid_codes):
        return None
    peer: str = request.state.peer
    return Seen(
        peer=peer,
        is_trusted=is_trusted(peer, settings.trusted_proxies),
        forwarded="x-forwarded-for" in request.headers,
        address=request.client.host,
        scheme=request.url.scheme,
    )
