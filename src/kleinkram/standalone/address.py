"""Addresses and ports of `klein up`: the options --listen, --port, --s3-port, --public-url and TLS."""

import ipaddress
import random
import socket
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from kleinkram.standalone.errors import PortTaken, StandaloneError
from kleinkram.standalone.object_store import ADMIN_GRPC_OFFSET, PORT_NAMES
from kleinkram.standalone.processes import port_listener

_PREFERRED = {"api": 8000, "store": 8001}
METRICS_PORTS = ("api_metrics", "worker_metrics")  # for Prometheus on this machine
_FLAGS = {"api": "--port", "store": "--s3-port"}
_PRIVATE_RANGE = range(20_000, 32_000)  # below the range that outgoing connections use


@dataclass(frozen=True)
class Listening:
    """Options about addresses and TLS; ports that are None are chosen and stay the same across restarts."""

    address: str = "127.0.0.1"
    port: int | None = None
    s3_port: int | None = None
    public_url: str | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None

    @property
    def tls(self) -> tuple[Path, Path] | None:
        """Certificate and key, or None without TLS."""
        return (self.tls_cert, self.tls_key) if self.tls_cert and self.tls_key else None

    def requested_ports(self) -> dict[str, str]:
        """Return the option that set each port, by the port's name."""
        return {name: _FLAGS[name] for name, port in (("api", self.port), ("store", self.s3_port)) if port}

    @property
    def needs_proxy(self) -> bool:
        """Whether clients reach the store by another port than the services of this machine do."""
        return not self.is_loopback or self.tls is not None

    @property
    def scheme(self) -> str:
        """`https` with a certificate, else `http`."""
        return "https" if self.tls_cert else "http"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        return self.address == "localhost" or ipaddress.ip_address(self.address).is_loopback

    @property
    def local_host(self) -> str:
        """The address by which this machine reaches itself."""
        if self.address == "localhost" or ipaddress.ip_address(self.address).is_unspecified:
            return "127.0.0.1"
        return f"[{self.address}]" if ":" in self.address else self.address


def check_listening(listening: Listening) -> None:
    """Check the options.

    Raises:
        StandaloneError: the address is no IP address, the public URL is no URL, or TLS lacks a file.
    """
    if listening.address != "localhost":
        try:
            ipaddress.ip_address(listening.address)
        except ValueError:
            raise StandaloneError(
                f"--listen {listening.address} is no IP address: give one of this machine's, or 0.0.0.0 for all."
            ) from None
    if listening.public_url is not None:
        parts = urlsplit(listening.public_url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise StandaloneError(f"--public-url {listening.public_url} is no URL: write http(s)://host[:port].")
    if (listening.tls_cert is None) != (listening.tls_key is None):
        raise StandaloneError("TLS needs both --tls-cert and --tls-key: give both, or neither.")
    for path in (listening.tls_cert, listening.tls_key):
        if path is not None and not path.is_file():
            raise StandaloneError(f"The TLS file {path} is not there: give the path of a PEM file.")


def assign_ports(listening: Listening, previous: dict[str, int]) -> dict[str, int]:
    """Return every port by name: from the options, else as at the last start, else a free one.

    Raises:
        PortTaken: a port of the options is taken.
    """
    assigned: dict[str, int] = {}
    for name, port in (("api", listening.port), ("store", listening.s3_port)):
        if port and (port in assigned.values() or not is_free(port, listening.address)):
            program = port_listener(port)
            raise PortTaken(
                f"Port {port} on {listening.address} is taken{f' by {program}' if program else ''}: "
                f"end that program, or choose another port with {_FLAGS[name]}."
            )
        assigned[name] = port or _choose(name, listening.address, previous, assigned)
    for name in ("postgres", *METRICS_PORTS, *PORT_NAMES):
        if name == "admin_grpc":
            assigned[name] = assigned["admin"] + ADMIN_GRPC_OFFSET
        else:
            assigned[name] = _choose(name, "127.0.0.1", previous, assigned)
    return assigned


def taken_ports(listening: Listening, ports: Mapping[str, int]) -> list[str]:
    """Return which of these ports other programs use: `port 8001 (nginx (pid 7))`. No service may run on them."""
    taken = []
    for name, port in ports.items():
        if not is_free(port, listening.address if name in _FLAGS else "127.0.0.1"):
            program = port_listener(port)
            taken.append(f"port {port}" + (f" ({program})" if program else ""))
    return taken


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


def public_urls(listening: Listening, ports: dict[str, int]) -> tuple[str, str]:
    """Return the addresses of API and store as clients reach them; the store's is part of every signature."""
    store_port = ports["store"]
    if listening.public_url:
        host = urlsplit(listening.public_url).hostname or ""
        host = f"[{host}]" if ":" in host else host
        return listening.public_url.rstrip("/"), f"{listening.scheme}://{host}:{store_port}"
    host = listening.local_host
    if not listening.is_loopback and ipaddress.ip_address(listening.address).is_unspecified:
        host = _primary_address()
    return f"{listening.scheme}://{host}:{ports['api']}", f"{listening.scheme}://{host}:{store_port}"


def _choose(name: str, address: str, previous: dict[str, int], assigned: dict[str, int]) -> int:
    def is_available(port: int, taken: Collection[int]) -> bool:
        needed = (port, port + ADMIN_GRPC_OFFSET) if name == "admin" else (port,)
        return all(number not in taken and is_free(number, address) for number in needed)

    for port in (previous.get(name), _PREFERRED.get(name)):
        if port and is_available(port, assigned.values()):
            return port
    reserved = {*assigned.values(), *(port for other, port in previous.items() if other != name)}
    return next(port for port in random.sample(_PRIVATE_RANGE, k=400) if is_available(port, reserved))


def _primary_address() -> str:
    """Return this machine's address on the way to others. A UDP socket sends nothing; it reads the routing table."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"
