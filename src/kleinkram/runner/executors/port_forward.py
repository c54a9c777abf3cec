"""`network: api`: a job without a network reaches the API and the store through sockets on its own loopback.

The sockets listen inside the network namespace of the job, and the runner forwards the bytes. There is no route, no
bridge and no firewall rule, and TLS holds from end to end. Imports only the standard library.
"""

import contextlib
import ctypes
import fcntl
import ipaddress
import os
import socket
import struct
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

_CONNECT_TIMEOUT_S = 30.0
_BUFFER_BYTES = 2**18
# Concurrent connections of one job; further ones wait. Each takes two threads.
_CONNECTIONS = 128
_LOCALHOST = "127.0.0.1"
_CLONE_NEWNET = 0x40000000
_SIOCSIFADDR = 0x8916

_libc = ctypes.CDLL(None, use_errno=True)


class PortForward(NamedTuple):
    """A host and port inside a job, and their target, which the runner resolves."""

    host: str
    port: int
    target_host: str
    target_port: int


def loopback_addresses(hosts: Sequence[str]) -> dict[str, str]:
    """Return the loopback address for each host inside a job; an IPv4 address stands for itself.

    Every name has its own address, so that several may use the same port.

    Raises:
        ValueError: an IPv6 address other than `::1`.
    """
    addresses: dict[str, str] = {}
    for host in hosts:
        try:
            literal = ipaddress.ip_address(host)
        except ValueError:
            names = [name for name, address in addresses.items() if address.startswith("127.1.")]
            addresses.setdefault(host, _LOCALHOST if host == "localhost" else f"127.1.0.{len(names) + 1}")
            continue
        if literal.version == 6 and not literal.is_loopback:
            raise ValueError(f"the IPv6 address {host} cannot be forwarded; a name or an IPv4 address can")
        addresses[host] = host
    return addresses


def host_entries(hosts: Sequence[str]) -> dict[str, str]:
    """Return the names that a job must resolve, with their addresses: the lines of its `/etc/hosts`."""
    return {name: address for name, address in loopback_addresses(hosts).items() if name not in (address, "localhost")}


def listen(forwards: Sequence[PortForward]) -> list[socket.socket]:
    """Open the listening sockets, in order, in the network namespace of this thread.

    Raises:
        OSError: this process may not, or two of them have the same address and port.
    """
    addresses = loopback_addresses([forward.host for forward in forwards])
    other = [address for address in addresses.values() if not ipaddress.ip_address(address).is_loopback]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for number, address in enumerate(dict.fromkeys(other)):
            value = struct.pack("HH4s8x", socket.AF_INET, 0, socket.inet_aton(address))
            fcntl.ioctl(any_socket, _SIOCSIFADDR, struct.pack("16s16s8x", f"lo:{number}".encode(), value))
    listeners = []
    for forward in forwards:
        address = addresses[forward.host]
        listener = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET)
        # Connections of an earlier runner may linger.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((address, forward.port))
        listener.listen(64)
        listeners.append(listener)
    return listeners


def listen_in_namespace(pid: int, forwards: Sequence[PortForward]) -> list[socket.socket]:
    """Open the listening sockets in the network namespace of a process.

    Raises:
        OSError: as `listen`; the process has ended.
    """
    listeners: list[socket.socket] = []
    errors: list[OSError] = []

    def enter() -> None:
        # A namespace belongs to a thread, and this one ends here.
        try:
            _enter_network_namespace(pid)
            listeners.extend(listen(forwards))
        except OSError as error:
            errors.append(error)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    for error in errors:
        raise error
    return listeners


def _enter_network_namespace(pid: int) -> None:
    with Path(f"/proc/{pid}/ns/net").open("rb") as namespace:
        if _libc.setns(namespace.fileno(), _CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), f"setns: {os.strerror(ctypes.get_errno())}")


def serve(listeners: Sequence[socket.socket], forwards: Sequence[PortForward]) -> None:
    """Forward all connections to their targets, in threads that end once `close` is called."""
    slots = threading.Semaphore(_CONNECTIONS)
    for listener, forward in zip(listeners, forwards, strict=True):
        threading.Thread(target=_accept, args=(listener, forward, slots), daemon=True).start()


def close(listeners: Sequence[socket.socket]) -> None:
    """Close listening sockets and wake their threads."""
    for listener in listeners:
        with contextlib.suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def _accept(listener: socket.socket, forward: PortForward, slots: threading.Semaphore) -> None:
    while True:
        slots.acquire()
        try:
            inside, _ = listener.accept()
        except ConnectionError:
            slots.release()
            continue
        except OSError:
            slots.release()
            return
        threading.Thread(target=_forward_one, args=(inside, forward, slots), daemon=True).start()


def _forward_one(inside: socket.socket, forward: PortForward, slots: threading.Semaphore) -> None:
    try:
        target = (forward.target_host, forward.target_port)
        with inside, socket.create_connection(target, _CONNECT_TIMEOUT_S) as outside:
            outside.settimeout(None)
            back = threading.Thread(target=_pump, args=(outside, inside), daemon=True)
            back.start()
            _pump(inside, outside)
            back.join()
    except OSError:
        return
    finally:
        slots.release()


def _pump(source: socket.socket, target: socket.socket) -> None:
    """Forward one direction to its end; the other one may continue."""
    try:
        while data := source.recv(_BUFFER_BYTES):
            target.sendall(data)
        target.shutdown(socket.SHUT_WR)
    except OSError:
        for end in (source, target):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
