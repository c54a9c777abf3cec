"""Connections to the store that send slices of files: where they can, without taking the bytes into this process.

A slice goes from the page cache to the socket by `sendfile`, which spares an upload about a tenth of its CPU time.
Over TLS, and where the file system or the kernel cannot do it, it is read and sent.

urllib3 makes the connections and keeps them. A PUT is spoken here: of a small file, its way through urllib3 and
`http.client` would cost more CPU time than all else that is done for the file.
"""

import contextlib
import errno
import http.client
import io
import os
import re
import ssl
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, cast

import urllib3
from urllib3.connection import HTTPSConnection
from urllib3.connectionpool import HTTPConnectionPool, HTTPSConnectionPool
from urllib3.util.wait import wait_for_write

import kleinkram
from kleinkram.client._network import WatchedConnection, WatchedPools
from kleinkram.client.transfer._source import FileSlice

CONNECT_TIMEOUT_S = 10.0
READ_TIMEOUT_S = 120.0
# The last two are the disk's: reading says so in words that are the file's.
_CANNOT = frozenset({errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EIO, errno.ESTALE})
# What is shorter is read and goes out in one piece with the request's head: one packet for the store to wake up for.
_TOGETHER_BYTES = 64 * 1024

# More than a client ever talks to: of more, urllib3 closes those of the longest unused.
_STORES = 100
_REQUEST = re.compile(r"PUT [!-~]+ HTTP/1\.1\r\n(?:[!-9;-~]+: [ -~]*\r\n)+\r\n")
# An answer that is all there, and says that it has no body. Every other is read by `http.client`.
_EMPTY_OK = re.compile(rb"HTTP/1\.1 200 [^\r\n]*\r\n(?:[!-9;-~]+:[^\r\n]*\r\n)+\r\n")
_LENGTH_0 = re.compile(rb"\r\ncontent-length: *0\r\n", re.IGNORECASE)
_OTHERWISE = re.compile(rb"\r\n(?:transfer-encoding:|connection: *close)", re.IGNORECASE)
_ETAG = re.compile(rb"\r\netag: *([^\r\n]*?) *\r\n", re.IGNORECASE)


class Reply(NamedTuple):
    """What the store answered to a PUT."""

    status: int
    etag: str
    content: bytes


class _PutConnection(WatchedConnection):
    """A connection that PUTs slices of files, and gives sending as much time as receiving."""

    _incoming: io.BufferedReader | None = None

    def connect(self) -> None:
        super().connect()
        if self.sock:  # urllib3 would send the first request with the time that connecting has
            self.sock.settimeout(READ_TIMEOUT_S)

    def close(self) -> None:
        if self._incoming is not None:
            self._incoming.close()
            self._incoming = None
        super().close()

    def put(self, target: str, headers: Mapping[str, str], body: Iterable[FileSlice | bytes]) -> Reply:
        """PUT, and return the answer."""
        if self.sock is None:
            self.timeout = CONNECT_TIMEOUT_S
            self.connect()
        if self._incoming is None:
            self._incoming = self.sock.makefile("rb")
        # The store may have answered, and left, before it was sent all.
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self._send_request(self._head(target, headers), body)
        return self._reply(self._incoming)

    def _head(self, target: str, headers: Mapping[str, str]) -> bytes:
        host = f"[{self.host}]" if ":" in self.host else self.host
        said = {
            "Host": host if self.port == self.default_port else f"{host}:{self.port}",
            "User-Agent": f"klein/{kleinkram.__version__}",
            "Accept-Encoding": "identity",
            **headers,
        }
        lines = "".join(f"{name}: {value}\r\n" for name, value in said.items())
        head = f"PUT {target} HTTP/1.1\r\n{lines}\r\n"
        if not _REQUEST.fullmatch(head) or head.count("\r\n") != len(said) + 2:
            raise ValueError("an address or a header holds what would be read as another")
        return head.encode()

    def _send_request(self, unsent: bytes, body: Iterable[FileSlice | bytes]) -> None:
        for piece in body:
            if isinstance(piece, bytes):
                unsent += piece
            elif piece.length <= _TOGETHER_BYTES:
                unsent += b"".join(piece.read())
            else:
                self.sock.sendall(unsent)
                _send_slice(self.sock, piece)
                unsent = b""
        if unsent:
            self.sock.sendall(unsent)

    def _reply(self, incoming: io.BufferedReader) -> Reply:
        head = incoming.peek()
        if _EMPTY_OK.fullmatch(head) and _LENGTH_0.search(head) and not _OTHERWISE.search(head):
            incoming.read(len(head))
            etag = _ETAG.search(head)
            return Reply(200, etag.group(1).decode("latin-1") if etag else "", b"")
        answer = http.client.HTTPResponse(cast("Any", _Begun(incoming)), method="PUT")
        answer.begin()
        reply = Reply(answer.status, answer.headers.get("ETag", ""), answer.read())
        self._incoming = None  # reading to the answer's end has closed it
        if answer.will_close:
            self.close()
        return reply


class _Begun:
    """Stands for a socket of which something has been read already: that and what follows is in `stream`."""

    def __init__(self, stream: io.BufferedReader) -> None:
        self._stream = stream

    def makefile(self, _mode: str) -> io.BufferedReader:
        """Return what is read next."""
        return self._stream


class _PlainConnection(_PutConnection):
    pass


class _TlsConnection(_PutConnection, HTTPSConnection):
    pass


class _Pool(HTTPConnectionPool):
    """The connections to one store."""

    def put(self, target: str, headers: Mapping[str, str], body: Iterable[FileSlice | bytes]) -> Reply:
        """PUT by a connection that is free, or a new one; where it fails, the connection is closed."""
        connection = cast("_PutConnection", self._get_conn())
        try:
            return connection.put(target, headers, body)
        except BaseException:
            connection.close()
            raise
        finally:
            self._put_conn(connection)


class _PlainPool(_Pool):
    ConnectionCls = _PlainConnection


class _TlsPool(_Pool, HTTPSConnectionPool):
    ConnectionCls = _TlsConnection


class Connections(WatchedPools):
    """Connections to stores, `most` kept of each; nothing is tried twice."""

    def __init__(self, most: int) -> None:
        timeout = urllib3.Timeout(connect=CONNECT_TIMEOUT_S, read=READ_TIMEOUT_S)
        super().__init__(_STORES, maxsize=most, timeout=timeout)
        self.pool_classes_by_scheme = {"http": _PlainPool, "https": _TlsPool}
        self._stores: dict[str, _Pool] = {}

    def put(self, url: str, headers: Mapping[str, str], body: Iterable[FileSlice | bytes]) -> Reply:
        """PUT to a signed address, which needs no escaping; `headers` say the length. No redirect is followed.

        Raises:
            urllib3.exceptions.HTTPError, http.client.HTTPException, OSError: there was no answer.
        """
        scheme, _, rest = url.partition("://")
        place, _, target = rest.partition("/")
        store = f"{scheme}://{place}"
        if store not in self._stores:
            self._stores[store] = cast("_Pool", self.connection_from_url(store))
        return self._stores[store].put(f"/{target}", headers, body)


def _send_slice(sock: Any, piece: FileSlice) -> None:
    sent = 0 if isinstance(sock, ssl.SSLSocket) else _send_by_kernel(sock, piece)
    for view in piece.from_byte(sent).read():
        sock.sendall(view)


def _send_by_kernel(sock: Any, piece: FileSlice) -> int:
    """Send a slice, and return how much of it; not all only where the kernel cannot, or the file ends before."""
    sent = 0
    while sent < piece.length:
        try:
            count = os.sendfile(sock.fileno(), piece.handle, piece.offset + sent, piece.length - sent)
        except BlockingIOError:
            if not wait_for_write(sock, sock.gettimeout()):
                raise TimeoutError(f"the store took nothing for {sock.gettimeout():.0f} s") from None
            continue
        except OSError as error:
            if error.errno in _CANNOT:
                return sent
            raise
        if count == 0:
            return sent
        sent += count
    return sent
