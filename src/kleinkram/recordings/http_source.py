"""A source over HTTP ranges, such as a presigned URL of an S3 store.

Reads nothing but the ranges it is asked for, follows no redirect, sends no credential, and says no more of the URL
than its host in errors: a presigned URL is a secret. Where a signature has run out, it asks for a new one.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from http.client import HTTPException, HTTPResponse
from urllib.parse import urlsplit

from kleinkram.recordings.connections import Connections, Exchange
from kleinkram.recordings.errors import SourceError
from kleinkram.recordings.limits import PARALLEL_READS
from kleinkram.recordings.sources import check_range

ATTEMPTS = 4
FIRST_PAUSE_S = 0.1


class HttpSource:
    """The bytes behind a URL that answers `Range` requests.

    `renew` is asked for another URL of the same bytes when one is refused (403), as one whose time is over is; it may
    be called by any of the threads that read, by one at a time. `check` is called once, when the server behind the URL
    fails (500): what is read may be damaged. `renew` is asked again before reading gives up, and may raise that it is.

    Attributes:
        bytes_read: bytes returned so far.
        reads: calls so far (retries not counted).
    """

    parallel_reads = PARALLEL_READS

    def __init__(
        self,
        url: str,
        *,
        size_bytes: int,
        name: str,
        connections: Connections | None = None,
        renew: Callable[[], str] | None = None,
        check: Callable[[], None] | None = None,
    ) -> None:
        self.name = name
        self.size_bytes = size_bytes
        self.bytes_read = 0
        self.reads = 0
        self._url = url
        self._host = urlsplit(url).netloc.rpartition("@")[2]
        self._lock = threading.Lock()
        self._renew = renew
        self._check = check
        self._renewing = threading.Lock()
        self._connections = connections or Connections(PARALLEL_READS)

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset`; a lost connection or a 5xx is tried again.

        Raises:
            SourceError: refused, or no answer after a few attempts.
        """
        check_range(self, offset, length)
        if length == 0:
            return b""
        data = self._fetch_stubbornly(offset, length)
        self._count(length)
        return data

    def read_short(self, ranges: Iterable[tuple[int, int]]) -> Iterator[bytes]:
        """Yield the bytes of each (offset, length), in order; the next few are asked for meanwhile.

        All in the calling thread: what has come waits in the connections, so each range had better be short.

        Raises:
            SourceError: as `read`.
        """
        under_way: deque[tuple[int, int, Exchange | None]] = deque()
        try:
            for offset, length in ranges:
                check_range(self, offset, length)
                under_way.append((offset, length, self._ask_ahead(offset, length)))
                if len(under_way) == PARALLEL_READS:
                    yield self._take_answer(*under_way.popleft())
            while under_way:
                yield self._take_answer(*under_way.popleft())
        finally:
            for *_, exchange in under_way:
                if exchange:
                    exchange.abandon()

    def _ask_ahead(self, offset: int, length: int) -> Exchange | None:
        if length == 0:
            return None
        try:
            return self._connections.send(urlsplit(self._url), _headers(offset, length))
        except (HTTPException, OSError):
            return None

    def _take_answer(self, offset: int, length: int, exchange: Exchange | None) -> bytes:
        if exchange is not None:
            try:
                data = self._receive(exchange, offset, length)
            except (_Retryable, _Refused):
                pass
            else:
                self._count(length)
                return data
        return self.read(offset, length)

    def _fetch_stubbornly(self, offset: int, length: int, attempt: int = 1) -> bytes:
        url = self._url
        try:
            return self._fetch(url, offset, length)
        except _Refused as error:
            if attempt == ATTEMPTS or not self._has_other(url):
                raise SourceError(f"{self.name}: {error}") from error
            return self._fetch_stubbornly(offset, length, attempt + 1)
        except _Retryable as error:
            if error.is_failure:
                self._ask_for_check()
            if attempt == ATTEMPTS:
                if error.is_failure and self._renew is not None:
                    self._renew()
                raise SourceError(f"{self.name}: {error} (tried {ATTEMPTS} times)") from error
        time.sleep(FIRST_PAUSE_S * 2 ** (attempt - 1))
        return self._fetch_stubbornly(offset, length, attempt + 1)

    def _ask_for_check(self) -> None:
        with self._lock:
            check, self._check = self._check, None
        if check is not None:
            check()

    def _has_other(self, refused: str) -> bool:
        """Get another URL in place of one that was refused; False where nobody has one."""
        if self._renew is None:
            return False
        with self._renewing:
            if self._url == refused:
                self._url = self._renew()
            return self._url != refused

    def _fetch(self, url: str, offset: int, length: int) -> bytes:
        try:
            exchange = self._connections.send(urlsplit(url), _headers(offset, length))
        except (HTTPException, OSError) as error:
            raise self._no_answer(error) from error
        return self._receive(exchange, offset, length)

    def _receive(self, exchange: Exchange, offset: int, length: int) -> bytes:
        try:
            with exchange as answer:
                self._check_answer(answer, offset, length)
                data = answer.read(length)
        except (HTTPException, OSError) as error:
            raise self._no_answer(error) from error
        if len(data) != length:
            raise _Retryable(f"{self._host} sent {len(data)} of {length} bytes at byte {offset}")
        return data

    def _no_answer(self, error: Exception) -> _Retryable:
        return _Retryable(f"no answer from {self._host}: {type(error).__name__}")

    def _count(self, length: int) -> None:
        with self._lock:
            self.bytes_read += length
            self.reads += 1

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
            raise SourceError(f"{self.name}: {self._host} answered '{got}' where '{expected}' was asked for")


def _headers(offset: int, length: int) -> dict[str, str]:
    return {"Range": f"bytes={offset}-{offset + length - 1}", "Accept-Encoding": "identity"}


class _Retryable(Exception):
    """The same request may succeed next time. `is_failure`: the server failed at it, and may for good."""

    def __init__(self, message: str, *, is_failure: bool = False) -> None:
        super().__init__(message)
        self.is_failure = is_failure


class _Refused(Exception):
    """The URL is not good for this, or no longer."""
