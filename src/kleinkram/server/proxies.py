"""From where a request really comes: what proxies say of it counts only where they are trusted."""

import ipaddress
from collections.abc import Sequence

from starlette.types import Scope

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def asker(peer: str, forwarded: Sequence[str], trusted: Sequence[Network]) -> str:
    """Return the nearest address that is not one of our own proxies'.

    `forwarded` is X-Forwarded-For, the nearest last: each proxy adds whom it heard, and whatever stands left of what
    an untrusted one said may be invented. So it is read from the right, as far as trust reaches; what is no address
    ends it.
    """
    heard = parse_address(peer)
    if heard is None:
        return peer
    for claim in reversed(forwarded):
        if not any(heard in network for network in trusted):
            break
        said = parse_address(claim)
        if said is None:
            break
        heard = said
    return str(heard)


def is_trusted(peer: str, trusted: Sequence[Network]) -> bool:
    """Say whether what connects from an address is one of our own proxies."""
    address = parse_address(peer)
    return address is not None and any(address in network for network in trusted)


def set_asker(scope: Scope, headers: Sequence[tuple[bytes, bytes]], trusted: Sequence[Network]) -> None:
    """Write into an ASGI scope from where the request comes, and by which scheme it came to the nearest proxy."""
    client = scope.get("client")
    if client is None:
        return
    is_proxy = is_trusted(client[0], trusted)
    scope["client"] = (asker(client[0], _listed(headers, b"x-forwarded-for") if is_proxy else [], trusted), client[1])
    schemes = _listed(headers, b"x-forwarded-proto") if is_proxy else []
    if schemes and schemes[-1].lower() in {"http", "https"}:
        scope["scheme"] = schemes[-1].lower()


def _listed(headers: Sequence[tuple[bytes, bytes]], name: bytes) -> list[str]:
    values = [value.decode("latin-1") for key, value in headers if key == name]
    return [part.strip() for value in values for part in value.split(",")]


def parse_address(text: str) -> Address | None:
    """Return an address, an IPv4 one that is mapped into IPv6 as itself; None where it is none."""
    try:
        found = ipaddress.ip_address(text.strip("[]"))
    except ValueError:
        return None
    mapped = found.ipv4_mapped if isinstance(found, ipaddress.IPv6Address) else None
    return mapped or found
