"""`network: api`: a run without network gets listening sockets on its own loopback, and its warden carries the bytes.

Each door is an address and port inside of the run, and one target outside. There is no route, no bridge and no firewall
rule: what is not a door is not there. TLS holds from end to end, since doors only carry.
Imports nothing but Python's own library, since wardens wait for it.
"""

import contextlib
import ipaddress
import socket
import threading
from collections.abc import Sequence
from typing import NamedTuple

from kleinkram.runner.process import kernel

_CONNECT_TIMEOUT_S = 30.0
_PIECE_BYTES = 2**18
# At once for one run; further ones wait. Each is two threads of the warden.
_CONNECTIONS = 128
_LOCALHOST = "127.0.0.1"


class Way(NamedTuple):
    """A door as wardens know it: a host's name and port inside, and where they lead."""

    host: str
    port: int
    target_host: str
    target_port: int


def addresses_of(hosts: Sequence[str]) -> dict[str, str]:
    """Return the loopback address that stands for each host inside of a run; an IPv4 address stands for itself.

    Every name has an address of its own, so that two may have the same port.

    Raises:
        ValueError: an IPv6 address other than `::1`.
    """
    found: dict[str, str] = {}
    for host in hosts:
        try:
            literal = ipaddress.ip_address(host)
        except ValueError:
            names = [each for each, address in found.items() if address.startswith("127.1.")]
            found.setdefault(host, _LOCALHOST if host == "localhost" else f"127.1.0.{len(names) + 1}")
            continue
        if literal.version == 6 and not literal.is_loopback:
            raise ValueError(f"no door can be made for the IPv6 address {host}; a name or an IPv4 address can")
        found[host] = host
    return found


def names_of(hosts: Sequence[str]) -> dict[str, str]:
    """Return those hosts that a run must look up, with their addresses inside of it: lines of its `/etc/hosts`."""
    return {host: address for host, address in addresses_of(hosts).items() if host not in (address, "localhost")}


def listen(ways: Sequence[Way]) -> list[socket.socket]:
    """Make the listening sockets of doors, in their order, in the network namespace that this thread is in.

    Raises:
        OSError: this process may not, or two doors have the same address and port.
    """
    if not ways:
        return []
    addresses = addresses_of([way.host for way in ways])
    foreign = [each for each in addresses.values() if not ipaddress.ip_address(each).is_loopback]
    for number, address in enumerate(dict.fromkeys(foreign)):
        kernel.add_to_loopback(address, number)
    return [_listener(addresses[way.host], way.port) for way in ways]


def _listener(address: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET)
    # Those of a warden before this one may have left connections behind.
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    made.bind((address, port))
    made.listen(64)
    return made


def listen_in(pid: int, ways: Sequence[Way]) -> list[socket.socket]:
    """Make the listening sockets of doors in the network namespace of a process.

    Raises:
        OSError: as `listen`; the process is over.
    """
    made: list[socket.socket] = []
    failed: list[OSError] = []

    def enter() -> None:
        # A namespace is a thread's own; this one goes no further.
        try:
            kernel.enter_network(pid)
            made.extend(listen(ways))
        except OSError as error:
            failed.append(error)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    for error in failed:
        raise error
    return made


def carry(listeners: Sequence[socket.socket], ways: Sequence[Way]) -> None:
    """Carry whatever comes to the listeners to their targets, by threads that end with this process."""
    free = threading.Semaphore(_CONNECTIONS)
    for listener, way in zip(listeners, ways, strict=True):
        threading.Thread(target=_answer, args=(listener, way, free), daemon=True).start()


def _answer(listener: socket.socket, way: Way, free: threading.Semaphore) -> None:
    while True:
        free.acquire()
        try:
            inside, _ = listener.accept()
        except OSError:
            free.release()
            continue
        threading.Thread(target=_carry_one, args=(inside, way, free), daemon=True).start()


def _carry_one(inside: socket.socket, way: Way, free: threading.Semaphore) -> None:
    try:
        target = (way.target_host, way.target_port)
        with inside, socket.create_connection(target, _CONNECT_TIMEOUT_S) as outside:
            outside.settimeout(None)
            back = threading.Thread(target=_pump, args=(outside, inside), daemon=True)
            back.start()
            _pump(inside, outside)
            back.join()
    except OSError:
        return
    finally:
        free.release()


def _pump(source: socket.socket, target: socket.socket) -> None:
    """Carry one direction to its end; the other one may go on."""
    try:
        while data := source.recv(_PIECE_BYTES):
            target.sendall(data)
        target.shutdown(socket.SHUT_WR)
    except OSError:
        for each in (source, target):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
