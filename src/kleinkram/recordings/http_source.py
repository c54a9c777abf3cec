"""Reads byte ranges over HTTP, such as from a presigned URL of an S3 store.

A summary over a network is about a thousand requests of a kilobyte. Through urllib3 each costs its caller 0.6 ms of
CPU time, most of it for parsing addresses and pooling that such requests have no use for; through `http.client`, less
than half of it. And one thread can have several requests under way, where many threads would wait for each other.
"""

from __future__ import annotations

import http.client
import select
import ssl
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from http.client import HTTPException, HTTPResponse
from urllib.parse import SplitResult, urlsplit

from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.limits import PARALLEL_READS
from kleinkram.recordings.sources import check_range

CONNECT_TIMEOUT_S = 10.0
READ_TIMEOUT_S = 30.0

_Origin = tuple[str, str, "int | None"]


class HttpConnections:
    """At most `max_idle` idle connections. Safe to share between threads."""

    def __init__(self, max_idle: int) -> None:
        self._max_idle = max_idle
        self._idle: list[tuple[_Origin, http.client.HTTPConnection]] = []
        self._lock = threading.Lock()
        self._tls: ssl.SSLContext | None = None
        # For a caller that forgets to close: sources are handed around, and few of their users own them.
        weakref.finalize(self, _close_all, self._idle)

    def send(self, url: SplitResult, headers: dict[str, str]) -> Exchange:
        """Send a GET without waiting for the response; `OSError` without a connection."""
        origin = (url.scheme, url.hostname or "", url.port)
        connection = self._take(origin)
        if connection is None:
            connection = self._new(*origin)
            connection.connect()
            connection.sock.settimeout(READ_TIMEOUT_S)
        target = url.path or "/"
        try:
            connection.request("GET", f"{target}?{url.query}" if url.query else target, headers=headers)
        except BaseException:
            connection.close()
            raise
        return Exchange(connection, lambda: self._keep(origin, connection))

    def close(self) -> None:
        """Close the idle connections."""
        with self._lock:
            _close_all(self._idle)

    def _new(self, scheme: str, host: str, port: int | None) -> http.client.HTTPConnection:
        if scheme != "https":
            return http.client.HTTPConnection(host, port, timeout=CONNECT_TIMEOUT_S)
        with self._lock:
            self._tls = self._tls or ssl.create_default_context()
        return http.client.HTTPSConnection(host, port, timeout=CONNECT_TIMEOUT_S, context=self._tls)

    def _take(self, origin: _Origin) -> http.client.HTTPConnection | None:
        while True:
            with self._lock:
                at = next((at for at in reversed(range(len(self._idle))) if self._idle[at][0] == origin), None)
                if at is None:
                    return None
                _, connection = self._idle.pop(at)
            waiting = select.poll()
            waiting.register(connection.sock, select.POLLIN)
            if not waiting.poll(0):  # else the server has closed it, or sent what nobody requested
                return connection
            connection.close()

    def _keep(self, origin: _Origin, connection: http.client.HTTPConnection) -> None:
        with self._lock:
            if len(self._idle) < self._max_idle:
                self._idle.append((origin, connection))
                return
        connection.close()


class Exchange:
    """A request whose response was not read yet; as a context, the response. `OSError` or `HTTPException` on entering.

    The connection is kept for others if all of the response was read.
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
        # A connection that the server ends has no socket any more: it belongs to the response.
        if self._answer is not None and self._answer.isclosed() and self._connection.sock is not None:
            self._keep()
        else:
            self.abandon()

    def abandon(self) -> None:
        """Close the connection."""
        if self._answer is not None:
            self._answer.close()
        self._connection.close()


def _close_all(idle: list[tuple[_Origin, http.client.HTTPConnection]]) -> None:
    while idle:
        _, connection = idle.pop()
        connection.close()


ATTEMPTS = 4
FIRST_PAUSE_S = 0.1


class HttpSource:
    """The bytes behind a URL that answers `Range` requests.

    `renew` returns another URL of the same bytes when one is refused (403), as an expired one is; any reading thread
    may call it, one at a time. `check` is called once if the server behind the URL fails (500): what is read may be
    damaged. Before reading gives up then, `renew` is called again, and may raise. `sha256`: of all bytes, where known.
    """

    parallel_reads = PARALLEL_READS

    def __init__(
        self,
        url: str,
        *,
        size_bytes: int,
        name: str,
        connections: HttpConnections | None = None,
        renew: Callable[[], str] | None = None,
        check: Callable[[], None] | None = None,
        sha256: str | None = None,
    ) -> None:
        self.name = name
        self.sha256 = sha256
        self.size_bytes = size_bytes
        self.bytes_read = 0
        self.reads = 0
        self._url = url
        self._host = urlsplit(url).netloc.rpartition("@")[2]
        self._lock = threading.Lock()
        self._renew = renew
        self._check = check
        self._renewing = threading.Lock()
        self._connections = connections or HttpConnections(PARALLEL_READS)

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; retries lost connections and 5xx.

        Raises:
            SourceError: refused, or no answer after a few attempts.
        """
        check_range(self, offset, length)
        if length == 0:
            return b""
        for attempt in range(1, ATTEMPTS + 1):
            url = self._url
            try:
                return self._receive(self._send(url, offset, length), offset, length)
            except _Refused as error:
                if attempt == ATTEMPTS or not self._has_other(url):
                    raise SourceError(f"{self.name}: {error}") from error
            except _Retryable as error:
                if error.is_failure:
                    with self._lock:
                        check, self._check = self._check, None
                    if check is not None:
                        check()
                if attempt == ATTEMPTS:
                    if error.is_failure and self._renew is not None:
                        self._renew()
                    raise SourceError(f"{self.name}: {error} (tried {ATTEMPTS} times)") from error
                time.sleep(FIRST_PAUSE_S * 2 ** (attempt - 1))
        raise AssertionError("the last attempt returns or raises")

    def read_short(self, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
        """Yield the bytes of each (offset, length), in order; the next requests are sent in advance.

        All in the calling thread: responses wait in the connections, so use it for short ranges only.
        """
        under_way: deque[tuple[int, int, Exchange | None]] = deque()
        try:
            for offset, length in ranges:
                check_range(self, offset, length)
                exchange = None
                if length:
                    with suppress(_Retryable):
                        exchange = self._send(self._url, offset, length)
                under_way.append((offset, length, exchange))
                if len(under_way) == PARALLEL_READS:
                    yield self._take_answer(*under_way.popleft())
            while under_way:
                yield self._take_answer(*under_way.popleft())
        finally:
            for *_, exchange in under_way:
                if exchange:
                    exchange.abandon()

    def _take_answer(self, offset: int, length: int, exchange: Exchange | None) -> bytes:
        if exchange is not None:
            with suppress(_Retryable, _Refused):
                return self._receive(exchange, offset, length)
        return self.read(offset, length)

    def _has_other(self, refused: str) -> bool:
        """Renew a refused URL; return whether there is another one."""
        if self._renew is None:
            return False
        with self._renewing:
            if self._url == refused:
                self._url = self._renew()
            return self._url != refused

    def _send(self, url: str, offset: int, length: int) -> Exchange:
        headers = {"Range": f"bytes={offset}-{offset + length - 1}", "Accept-Encoding": "identity"}
        try:
            return self._connections.send(urlsplit(url), headers)
        except (HTTPException, OSError) as error:
            raise self._no_answer(error) from error

    def _receive(self, exchange: Exchange, offset: int, length: int) -> bytes:
        try:
            with exchange as answer:
                self._check_answer(answer, offset, length)
                data = answer.read(length)
        except (HTTPException, OSError) as error:
            raise self._no_answer(error) from error
        if len(data) != length:
            raise _Retryable(f"{self._host} sent {len(data)} of {length} bytes at byte {offset}")
        with self._lock:
            self.bytes_read += length
            self.reads += 1
        return data

    def _no_answer(self, error: Exception) -> _Retryable:
        return _Retryable(f"no answer from {self._host}: {type(error).__name__}")

    def _check_answer(self, answer: HTTPResponse, offset: int, length: int) -> None:
        status = answer.status
        if status >= 500 or status == 429:
            raise _Retryable(f"{self._host} answered {status}", is_failure=status == 500)
        if status == 403:
            raise _Refused(f"{self._host} refused bytes {offset}+{length} with 403")
        if status == 200:
            raise SourceError(f"{self.name}: {self._host} ignores range requests (it answered 200, not 206)")
        if status != 206:
            raise SourceError(f"{self.name}: {self._host} refused bytes {offset}+{length} with {status}")
        expected = f"bytes {offset}-{offset + length - 1}/{self.size_bytes}"
        got = answer.headers.get("Content-Range", "")
        if got != expected:
            raise SourceError(f"{self.name}: {self._host} answered '{got}' where '{expected}' was requested")


class _Retryable(Exception):
    """A request that may succeed next time. `is_failure`: the server failed, perhaps permanently."""

    def __init__(self, message: str, *, is_failure: bool = False) -> None:
        super().__init__(message)
        self.is_failure = is_failure


class _Refused(Exception):
    """The URL was refused, or has expired."""
