"""The ways out of a run with the network `api`: to the API and the store, by the addresses that clients use."""

from urllib.parse import urlsplit

from kleinkram.runner.work import Door

_PORTS = {"http": 80, "https": 443}


def doors_to(*urls: str) -> tuple[Door, ...]:
    """Return a door to each server that these addresses name."""
    return tuple(dict.fromkeys(_door(url) for url in urls if url))


def _door(url: str) -> Door:
    parts = urlsplit(url)
    host, port = parts.hostname or "", parts.port or _PORTS[parts.scheme]
    return Door(host, port, host, port)
