"""Headers of requests and responses: the client address behind trusted proxies, and the security headers."""

import hashlib
import hmac
import ipaddress
import time
from collections.abc import Iterable, Sequence
from typing import Annotated

from fastapi import Header, Request
from pydantic import BaseModel, ConfigDict
from starlette.types import Scope

from kleinkram.server.settings import Network, Settings

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
RawHeader = tuple[bytes, bytes]

# The API serves no pages; pages set a policy of their own.
API_POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
# Pages may run and load what this server serves, nothing inline and nothing from other origins.
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; font-src 'self'; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
_DEFAULTS: Sequence[RawHeader] = (
    (b"content-security-policy", API_POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), geolocation=(), microphone=(), payment=()"),
    # Responses are personal, and some contain secrets: signed URLs, tokens.
    (b"cache-control", b"no-store"),
)
_YEAR_S = 365 * 86_400
_HSTS: RawHeader = (b"strict-transport-security", f"max-age={_YEAR_S}".encode())


def with_security_headers(headers: Iterable[RawHeader], *, is_https: bool) -> list[RawHeader]:
    """Return a response's headers plus the security headers that it does not set itself."""
    own_headers = list(headers)
    own_names = {name.lower() for name, _ in own_headers}
    defaults = [*_DEFAULTS, _HSTS] if is_https else _DEFAULTS
    return [*own_headers, *(header for header in defaults if header[0] not in own_names)]


def client_address(peer: str, forwarded_for: Sequence[str], trusted_proxies: Sequence[Network]) -> str:
    """Return the nearest address that is not one of our own proxies.

    `forwarded_for` is X-Forwarded-For, nearest last. Each proxy appends the address of its peer, so entries left of an
    untrusted proxy's may be forged: the list is read from the right, while proxies are trusted and addresses valid.
    """
    address = parse_address(peer)
    if address is None:
        return peer
    for entry in reversed(forwarded_for):
        if not any(address in network for network in trusted_proxies):
            break
        previous = parse_address(entry)
        if previous is None:
            break
        address = previous
    return str(address)


def is_trusted(peer: str, trusted_proxies: Sequence[Network]) -> bool:
    """Whether an address belongs to one of our own proxies."""
    address = parse_address(peer)
    return address is not None and any(address in network for network in trusted_proxies)


def set_client_address(scope: Scope, trusted_proxies: Sequence[Network]) -> None:
    """Set the client's address and scheme in an ASGI scope from the headers of trusted proxies."""
    client = scope.get("client")
    if client is None:
        return
    headers: Sequence[RawHeader] = scope["headers"]
    is_proxy = is_trusted(client[0], trusted_proxies)
    forwarded_for = _list_values(headers, b"x-forwarded-for") if is_proxy else []
    scope["client"] = (client_address(client[0], forwarded_for, trusted_proxies), client[1])
    schemes = _list_values(headers, b"x-forwarded-proto") if is_proxy else []
    if schemes and schemes[-1].lower() in {"http", "https"}:
        scope["scheme"] = schemes[-1].lower()


def parse_address(text: str) -> Address | None:
    """Return an address, with IPv4-mapped IPv6 as IPv4; None if it is invalid."""
    try:
        address = ipaddress.ip_address(text.strip("[]"))
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return mapped or address


def _list_values(headers: Sequence[RawHeader], name: bytes) -> list[str]:
    values = [value.decode("latin-1") for key, value in headers if key == name]
    return [part.strip() for value in values for part in value.split(",")]


IfMatch = Annotated[
    str | None,
    Header(alias="If-Match", max_length=1000, description="The `etag` of the object that was edited, in quotes."),
]


CHECK_HEADER = "X-Kleinkram-Check"
EVENT_STREAM = "text/event-stream"
UNBUFFERED = {"X-Accel-Buffering": "no"}  # nginx: do not buffer
_CODE_LIFETIME_S = 300


class RequestOrigin(BaseModel):
    """How a request reached this process: `peer` connected; `address` and `scheme` are attributed to the client.

    `forwarded_for`: X-Forwarded-For, nearest last.
    """

    model_config = ConfigDict(frozen=True)

    peer: str
    forwarded_for: tuple[str, ...]
    address: str
    scheme: str


def operator_code(settings: Settings, *, at_s: float | None = None) -> str:
    """Return a code that only holders of these settings can compute, valid for some minutes."""
    period = int((time.time() if at_s is None else at_s) // _CODE_LIFETIME_S)
    key = settings.s3_secret_key.get_secret_value().encode()
    return hmac.new(key, f"kleinkram check {period}".encode(), hashlib.sha256).hexdigest()


def request_origin(request: Request, settings: Settings) -> RequestOrigin | None:
    """Return how a request reached this process; None without a valid operator code."""
    code = request.headers.get(CHECK_HEADER, "")
    valid_codes = [operator_code(settings, at_s=time.time() - ago_s) for ago_s in (0, _CODE_LIFETIME_S)]
    if request.client is None or not any(hmac.compare_digest(code.encode(), valid.encode()) for valid in valid_codes):
        return None
    peer: str = request.state.peer
    return RequestOrigin(
        peer=peer,
        forwarded_for=tuple(_list_values(request.scope["headers"], b"x-forwarded-for")),
        address=request.client.host,
        scheme=request.url.scheme,
    )
