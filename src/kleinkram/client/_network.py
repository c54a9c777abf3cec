"""HTTP connections that detect a lost network within seconds.

A robot that moves gets another address or loses its network, and its connections hang. The kernel ends such a
connection after 15 seconds, when the peer acknowledges nothing and answers no keepalive probe. `NetworkMonitor` ends it
earlier: when this machine no longer has the address of the connection, or when a new connection to the same peer is
answered while this one is not.
"""

import errno
import socket
import struct
import sys
import threading
import time
import weakref
from collections.abc import Callable
from typing import Any

import urllib3
from typing_extensions import Self
from urllib3.connection import HTTPConnection, HTTPSConnection
from urllib3.connectionpool import HTTPConnectionPool, HTTPSConnectionPool

# As shown to users: the kernel's timers below end 13 to 15 seconds after the last answer.
SILENCE_S = 15
# Linux has all but TCP_KEEPALIVE, which is what macOS calls TCP_KEEPIDLE.
_TCP_OPTIONS = {"TCP_KEEPIDLE": 5, "TCP_KEEPALIVE": 5, "TCP_KEEPINTVL": 3, "TCP_KEEPCNT": 3, "TCP_USER_TIMEOUT": 13_000}
# For a peer that acknowledges but reads nothing, such as a store with a busy disk: Linux counts that as silence, too.
_BUSY_TIMEOUT_MS = 120_000
_LOOK_EVERY_S = 0.25
# When bytes are not acknowledged for so long, another connection is tried.
_STALLED_S = 2.0
_TRIAL_S = 1.0
# Where `struct tcp_info` of Linux (linux/tcp.h) has tcpi_unacked, tcpi_last_ack_recv in milliseconds, and
# tcpi_notsent_bytes, which Linux before 4.6 leaves out.
_TCP_INFO = struct.Struct("=24xI28xI84xI")

_lock = threading.RLock()  # its owner may collect garbage, which closes connections
_open_connections: "weakref.WeakValueDictionary[int, WatchedConnection]" = weakref.WeakValueDictionary()


def socket_options() -> list[tuple[int, int, int]]:
    """Return the socket options with which the kernel ends a connection whose peer is silent."""
    tcp = {name: getattr(socket, name) for name in _TCP_OPTIONS if hasattr(socket, name)}
    return [
        *HTTPConnection.default_socket_options,
        (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
        *((socket.IPPROTO_TCP, option, _TCP_OPTIONS[name]) for name, option in tcp.items()),
    ]


def has_address(address: tuple[Any, ...]) -> bool:  # Any: the shape of a socket's name depends on its family
    """Return whether this machine still has the local address of a socket."""
    host, _, *rest = address
    family = socket.AF_INET6 if rest else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as trial:
            trial.bind((host, 0, *rest))
    except OSError as error:
        return error.errno != errno.EADDRNOTAVAIL
    return True


def _connections() -> "list[WatchedConnection]":
    """Return a copy of the open connections, which other threads change."""
    return [connection for ref in _open_connections.valuerefs() if (connection := ref()) is not None]


class WatchedConnection(HTTPConnection):
    """A connection that a `NetworkMonitor` can end from another thread."""

    _own_address: tuple[Any, ...] | None = None
    _unacknowledged_since: float | None = None
    _is_busy = False

    def connect(self) -> None:
        super().connect()
        self._is_busy = False
        if self.sock:
            self._own_address = self.sock.getsockname()
            with _lock:
                _open_connections[id(self)] = self

    def close(self) -> None:
        with _lock:  # the number of a closed socket may belong to another one
            _open_connections.pop(id(self), None)
        super().close()

    @property
    def is_connected(self) -> bool:
        """Whether the pool may use it again."""
        return super().is_connected and not self.is_stranded()

    def is_stranded(self) -> bool:
        """Return whether this machine has lost the address that the connection was made from."""
        return self._own_address is not None and not has_address(self._own_address)

    def end_if_stranded(self) -> str | None:
        """Shut down a stranded connection, and return the lost address."""
        address = self._own_address
        return str(address[0]) if address is not None and self.is_stranded() and self.shut_down() else None

    def stalled_s(self) -> float:
        """Return for how long sent bytes have not been acknowledged; 0 where the kernel does not say."""
        sock = self.sock
        if sys.platform != "linux" or sock is None:
            return 0.0
        try:
            info = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO.size)
            unacknowledged, last_ms, unsent_bytes = _TCP_INFO.unpack(info.ljust(_TCP_INFO.size, b"\0"))
            is_busy = unacknowledged == 0 and unsent_bytes > 0
            if is_busy is not self._is_busy:  # a busy peer is there: have the kernel wait longer
                timeout_ms = _BUSY_TIMEOUT_MS if is_busy else _TCP_OPTIONS["TCP_USER_TIMEOUT"]
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, timeout_ms)
                self._is_busy = is_busy
        except OSError:
            return 0.0
        now = time.monotonic()
        if unacknowledged == 0:
            self._unacknowledged_since = None
        elif self._unacknowledged_since is None:
            self._unacknowledged_since = now
        since = self._unacknowledged_since
        return 0.0 if since is None else min(now - since, last_ms / 1000)

    def peer(self) -> tuple[str, int] | None:
        """Return the address of the peer."""
        sock = self.sock
        try:
            return sock.getpeername()[:2] if sock else None
        except OSError:
            return None

    def shut_down(self) -> bool:
        """End a connection that is known to be open, and wake the thread that waits for it."""
        self._own_address = None  # reported once; the pool notices the closed socket by itself
        try:
            # Also under TLS: no peer would receive a close notification.
            socket.socket.shutdown(self.sock, socket.SHUT_RDWR)
        except (OSError, TypeError):
            return False  # it has ended
        return True


class _WatchedTlsConnection(WatchedConnection, HTTPSConnection):
    pass


class _PlainPool(HTTPConnectionPool):
    ConnectionCls = WatchedConnection


class _TlsPool(HTTPSConnectionPool):
    ConnectionCls = _WatchedTlsConnection


class WatchedPools(urllib3.PoolManager):
    """Pools of watched connections; nothing is tried twice."""

    def __init__(self, pools: int = 10, *, maxsize: int, timeout: urllib3.Timeout) -> None:
        super().__init__(pools, maxsize=maxsize, retries=False, timeout=timeout, socket_options=socket_options())
        self.pool_classes_by_scheme = {"http": _PlainPool, "https": _TlsPool}


class NetworkMonitor:
    """Ends connections of this process that will never be answered. A context manager, with one thread.

    `lost` is called from that thread: with each address that this machine has lost, or with None where only the route
    changed, as behind a router that has changed its network.
    """

    def __init__(self, lost: Callable[[str | None], None]) -> None:
        self._lost = lost
        self._answered_at: dict[tuple[str, int], float] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="network monitor", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._over.wait(_LOOK_EVERY_S):
            with _lock:
                opened = _connections()
                ended = {address for one in opened if (address := one.end_if_stranded())}
                stalled = {peer for one in opened if one.stalled_s() > _STALLED_S and (peer := one.peer())}
            for address in ended:
                self._lost(address)
            self._answered_at = {peer: moment for peer, moment in self._answered_at.items() if peer in stalled}
            for peer in stalled:
                self._try_another(peer)

    def _try_another(self, peer: tuple[str, int]) -> None:
        """Connect to the peer of stalled connections; end these if it answers and they stay silent as long again.

        TCP retransmits after pauses as long as the silence so far, so a live connection needs that time.
        """
        if peer not in self._answered_at:
            try:
                socket.create_connection(peer, timeout=_TRIAL_S).close()
            except OSError:
                return
            self._answered_at[peer] = time.monotonic()
        answered_s = time.monotonic() - self._answered_at[peer]
        with _lock:
            dead = [one for one in _connections() if one.peer() == peer and answered_s > one.stalled_s() / 2 > 0]
            dead = [one for one in dead if one.stalled_s() > 2 * _STALLED_S and one.shut_down()]
        if dead:
            self._lost(None)
