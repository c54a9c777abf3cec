"""What `klein up` listens on and what it is called from outside: the answers to --listen, --port, --public-url, TLS."""

import ipaddress
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from kleinkram.standalone.errors import PortTaken, StandaloneError
from kleinkram.standalone.ports import choose_port, is_free
from kleinkram.standalone.procs import listener
from kleinkram.standalone.store import PORT_NAMES

_PREFERRED = {"api": 8000, "store": 8001}
# Where Prometheus may scrape, on this machine only.
METRICS_PORTS = ("api_metrics", "worker_metrics")
_FLAGS = {"api": "--port", "store": "--s3-port"}


@dataclass(frozen=True)
class Listening:
    """Options of `klein up` about addresses; ports that are None are chosen and remembered."""

    address: str = "127.0.0.1"
    port: int | None = None
    s3_port: int | None = None
    public_url: str | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None

    @property
    def tls(self) -> tuple[Path, Path] | None:
        """Certificate and key, where both are given."""
        return (self.tls_cert, self.tls_key) if self.tls_cert and self.tls_key else None

    def asked_for(self) -> dict[str, str]:
        """The ports that were given, by name, with the option that gave each."""
        return {name: _FLAGS[name] for name, port in (("api", self.port), ("store", self.s3_port)) if port}

    @property
    def needs_door(self) -> bool:
        """Whether clients reach the store by another port than this machine's own parts do."""
        return not self.is_loopback or self.tls is not None

    @property
    def scheme(self) -> str:
        """`https` where a certificate is given."""
        return "https" if self.tls_cert else "http"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can connect."""
        return self.address == "localhost" or ipaddress.ip_address(self.address).is_loopback

    @property
    def local_host(self) -> str:
        """The address by which this machine reaches itself."""
        if self.address == "localhost":
            return "127.0.0.1"
        given = ipaddress.ip_address(self.address)
        if given.is_unspecified:
            return "127.0.0.1"
        return f"[{given}]" if given.version == 6 else str(given)


def check_listening(listening: Listening) -> None:
    """Refuse what cannot be meant.

    Raises:
        StandaloneError: the address is none of this machine's, the public URL is no URL, or TLS lacks a file.
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


def settle_ports(listening: Listening, remembered: dict[str, int]) -> dict[str, int]:
    """Every port by name: those given, else those of the last start, else free ones.

    Raises:
        PortTaken: one that was given is taken.
    """
    settled: dict[str, int] = {}
    for name, given in (("api", listening.port), ("store", listening.s3_port)):
        settled[name] = given or _settle(name, listening.address, remembered, settled)
        if given and (given in list(settled.values())[:-1] or not is_free(given, listening.address)):
            holder = listener(given)
            raise PortTaken(
                f"Port {given} on {listening.address} is taken{f' by {holder}' if holder else ''}: "
                f"end that program, or choose another port with {_FLAGS[name]}."
            )
    for name in ("postgres", *METRICS_PORTS, *PORT_NAMES):
        settled[name] = _settle(name, "127.0.0.1", remembered, settled)
    return settled


def taken_ports(listening: Listening, ports: Mapping[str, int]) -> list[str]:
    """Say which of these ports somebody holds: `port 8001 (nginx (pid 7))`. None of ours may run."""
    found = []
    for name, port in ports.items():
        if not is_free(port, listening.address if name in _FLAGS else "127.0.0.1"):
            holder = listener(port)
            found.append(f"port {port}" + (f" ({holder})" if holder else ""))
    return found


def public_urls(listening: Listening, ports: dict[str, int]) -> tuple[str, str]:
    """The API's and the store's address as clients reach them; the store's is part of every signature."""
    scheme = listening.scheme
    if listening.public_url:
        host = urlsplit(listening.public_url).hostname or ""
        host = f"[{host}]" if ":" in host else host
        return listening.public_url.rstrip("/"), f"{scheme}://{host}:{ports['store']}"
    host = listening.local_host if listening.is_loopback or not _is_wildcard(listening.address) else _primary_address()
    return f"{scheme}://{host}:{ports['api']}", f"{scheme}://{host}:{ports['store']}"


def _settle(name: str, address: str, remembered: dict[str, int], taken: dict[str, int]) -> int:
    others = {*taken.values(), *(port for other, port in remembered.items() if other != name)}
    for port in (remembered.get(name), _PREFERRED.get(name)):
        if port and port not in taken.values() and is_free(port, address):
            return port
    return choose_port(besides=others, address=address)


def _is_wildcard(address: str) -> bool:
    return ipaddress.ip_address(address).is_unspecified


def _primary_address() -> str:
    """This machine's address on the way to others. Sends nothing: a UDP socket only asks the routing table."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"
