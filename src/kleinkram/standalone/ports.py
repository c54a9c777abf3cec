"""Choosing TCP ports: free, below the range that outgoing connections use, stable across restarts."""

import random
import socket
from collections.abc import Collection, Iterable

_PRIVATE_RANGE = range(20_000, 32_000)


def is_free(port: int, address: str = "127.0.0.1") -> bool:
    """Whether a server could listen on `address:port` now."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address, port))
        except OSError:
            return False
    return True


def choose_port(*, besides: Collection[int] = (), address: str = "127.0.0.1") -> int:
    """A free port that is not in `besides`. Not reserved: another program may take it before it is used."""
    candidates = random.sample(_PRIVATE_RANGE, k=400)
    return next(port for port in candidates if port not in besides and is_free(port, address))


def choose_ports(names: Iterable[str], *, besides: Collection[int] = ()) -> dict[str, int]:
    """A free loopback port for each name, all different."""
    chosen: dict[str, int] = {}
    for name in names:
        chosen[name] = choose_port(besides={*besides, *chosen.values()})
    return chosen
