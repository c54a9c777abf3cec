"""Kept connections for short range requests.

A summary over a network is about a thousand requests of a kilobyte. Through urllib3 each costs its caller 0.6 ms of
CPU time, most of it for parsing addresses and pooling that such requests have no use for; through `http.client`, less
than half of it. And one thread can have several requests under way, where many threads would wait for each other.
"""

from __future__ import annotations

import http.client
import select
import ssl
import threading
import weakref
from collections.abc import Callable
from urllib.parse import SplitResult

CONNECT_TIMEOUT_S = 10.0
READ_TIMEOUT_S = 30.0

_Place = tuple[str, str, "int | None"]


class Connections:
    """At most `most` idle connections. Safe to share between threads."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._idle: list[tuple[_Place, http.client.HTTPConnection]] = []
        self._lock = threading.Lock()
        self._tls: ssl.SSLContext | None = None
        # For a caller that forgets to close: sources are handed around, and few of their users own them.
        weakref.finalize(self, _close_all, self._idle)

    def send(self, url: SplitResult, headers: dict[str, str]) -> Exchange:
        """Send a GET; its answer may be waited for later.

        Raises:
            OSError: no connection, or it was lost.
        """
        place = (url.scheme, url.hostname or "", url.port)
        connection = self._take(place) or self._open(place)
        target = url.path or "/"
        try:
            connection.request("GET", f"{target}?{url.query}" if url.query else target, headers=headers)
        except BaseException:
            connection.close()
            raise
        return Exchange(connection, lambda: self._keep(place, connection))

    def close(self) -> None:
        """Close those that are idle."""
        with self._lock:
            _close_all(self._idle)

    def _open(self, place: _Place) -> http.client.HTTPConnection:
        scheme, host, port = place
        connection: http.client.HTTPConnection
        if scheme == "https":
            connection = http.client.HTTPSConnection(host, port, timeout=CONNECT_TIMEOUT_S, context=self._context())
        else:
            connection = http.client.HTTPConnection(host, port, timeout=CONNECT_TIMEOUT_S)
        connection.connect()
        connection.sock.settimeout(READ_TIMEOUT_S)
        return connection

    def _context(self) -> ssl.SSLContext:
        with self._lock:
            if self._tls is None:
                self._tls = ssl.create_default_context()
            return self._tls

    def _take(self, place: _Place) -> http.client.HTTPConnection | None:
        while True:
            with self._lock:
                at = next((at for at in reversed(range(len(self._idle))) if self._idle[at][0] == place), None)
                if at is None:
                    return None
                _, connection = self._idle.pop(at)
            if not _was_dropped(connection):
                return connection
            connection.close()

    def _keep(self, place: _Place, connection: http.client.HTTPConnection) -> None:
        with self._lock:
            if len(self._idle) < self._most:
                self._idle.append((place, connection))
                return
        connection.close()


class Exchange:
    """A request that was sent. As a context, its answer, whose body is not read yet.

    The connection is kept for others if all of the answer was read.

    Raises (on entering):
        OSError: the connection was lost.
        http.client.HTTPException: the answer is not HTTP.
    """

    def __init__(self, connection: http.client.HTTPConnection, keep: Callable[[], None]) -> None:
        self._connection = connection
        self._keep = keep
        self._answer: http.client.HTTPResponse | None = None

    def __enter__(self) -> http.client.HTTPResponse:
        try:
            self._answer = self._connection.getresponse()
        except BaseException:
            self._connection.close()
            raise
        return self._answer

    def __exit__(self, *_: object) -> None:
        # A connection that the server means to end has no socket any more: it is the answer's.
        if self._answer is not None and self._answer.isclosed() and self._connection.sock is not None:
            self._keep()
        else:
            self.abandon()

    def abandon(self) -> None:
        """Close the connection, whatever it still brings."""
        if self._answer is not None:
            self._answer.close()
        self._connection.close()


def _close_all(idle: list[tuple[_Place, http.client.HTTPConnection]]) -> None:
    while idle:
        _, connection = idle.pop()
        connection.close()


def _was_dropped(connection: http.client.HTTPConnection) -> bool:
    """Whether an idle connection has something to read: its end, or what nobody asked for."""
    waiting = select.poll()
    waiting.register(connection.sock, select.POLLIN)
    return bool(waiting.poll(0))
