"""Requests to the object store: PUT and GET of signed URLs, and the meaning of each answer.

`sendfile` sends a slice of a file from the page cache to the socket. Over TLS, and where the file system or the kernel
lacks `sendfile`, the slice is read and sent. urllib3 makes and keeps the connections. The PUT is written here because
urllib3's costs more CPU time: measured on one core, 310 us instead of 60 us for a small file, and 1.9 ms instead of
1.2 ms for a part of 5 MiB.

The threads of a transfer share one pool of connections.
"""

import contextlib
import enum
import errno
import http.client
import io
import os
import re
import socket
import ssl
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, cast

import urllib3
from urllib3.connection import HTTPConnection
from urllib3.connectionpool import HTTPConnectionPool
from urllib3.util.wait import wait_for_write

import kleinkram
from kleinkram.client._http import reason_of
from kleinkram.client._network import WatchedPools
from kleinkram.client.transfer.plan import FileSlice

CONNECT_TIMEOUT_S = 10.0
READ_TIMEOUT_S = 120.0
# Errors after which the slice is read instead; the last two are the disk's, which reading reports with the file's name.
_SENDFILE_UNSUPPORTED = frozenset({errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.EIO, errno.ESTALE})
# Shorter bodies are sent together with the request's head, so that the store receives one packet.
_SEND_WITH_HEAD_BYTES = 64 * 1024

# More stores than a client uses: urllib3 closes the connections to the least recently used one.
_STORES = 100
_REQUEST = re.compile(r"PUT [!-~]+ HTTP/1\.1\r\n(?:[!-9;-~]+: [ -~]*\r\n)+\r\n")
# A complete answer without a body. `http.client` reads all others.
_EMPTY_OK = re.compile(rb"HTTP/1\.1 200 [^\r\n]*\r\n(?:[!-9;-~]+:[^\r\n]*\r\n)+\r\n")
_LENGTH_0 = re.compile(rb"\r\ncontent-length: *0\r\n", re.IGNORECASE)
_OTHERWISE = re.compile(rb"\r\n(?:transfer-encoding:|connection: *close)", re.IGNORECASE)
_ETAG = re.compile(rb"\r\netag: *([^\r\n]*?) *\r\n", re.IGNORECASE)

# How long a transfer retries a store or a server that is unavailable.
TRANSFER_RETRY_S = 240.0

_LEAST_SLICE_BYTES = 64 * 1024
_QUICK_SLICE_S = 0.5

_GONE = frozenset({"NoSuchUpload", "NoSuchKey"})
# Codes that concern the store as a whole, not one object.
_STORE_WIDE_CODES = frozenset({"", "ServiceUnavailable", "SlowDown", "XMinioStorageFull"})
# Errors of the server that no retry helps.
_NOT_RETRIED = frozenset({501, 505})
_CODE = re.compile(rb"<Code>([A-Za-z]{1,64})</Code>")


class Reply(NamedTuple):
    """What the store answered to a PUT."""

    status: int
    etag: str
    content: bytes


def _put(
    connection: HTTPConnection, target: str, headers: Mapping[str, str], body: Iterable[FileSlice | bytes]
) -> Reply:
    """PUT over a connection, and return the answer."""
    if connection.sock is None:
        connection.timeout = CONNECT_TIMEOUT_S
        connection.connect()
    sock = connection.sock
    sock.settimeout(READ_TIMEOUT_S)  # for sending, too
    host = f"[{connection.host}]" if ":" in connection.host else connection.host
    fields = {
        "Host": host if connection.port == connection.default_port else f"{host}:{connection.port}",
        "User-Agent": f"klein/{kleinkram.__version__}",
        "Accept-Encoding": "identity",
        **headers,
    }
    head = f"PUT {target} HTTP/1.1\r\n" + "".join(f"{name}: {value}\r\n" for name, value in fields.items()) + "\r\n"
    if not _REQUEST.fullmatch(head) or head.count("\r\n") != len(fields) + 2:
        raise ValueError("an address or a header holds what would be read as another")
    unsent = head.encode()
    # The store may answer, and close the connection, before all is sent.
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        for piece in body:
            if isinstance(piece, bytes):
                unsent += piece
            elif piece.length <= _SEND_WITH_HEAD_BYTES:
                unsent += b"".join(piece.read())
            else:
                sock.sendall(unsent)
                _send_slice(sock, piece)
                unsent = b""
        if unsent:
            sock.sendall(unsent)
    with sock.makefile("rb") as incoming:
        answer = incoming.peek()
        if _EMPTY_OK.fullmatch(answer) and _LENGTH_0.search(answer) and not _OTHERWISE.search(answer):
            etag = _ETAG.search(answer)
            return Reply(200, etag.group(1).decode("latin-1") if etag else "", b"")
        response = http.client.HTTPResponse(cast("socket.socket", _BufferedSocket(incoming)), method="PUT")
        response.begin()
        reply = Reply(response.status, response.headers.get("ETag", ""), response.read())
    if response.will_close:
        connection.close()
    return reply


class _BufferedSocket(NamedTuple):
    """Stands for a socket some of whose bytes are in the buffer of `stream`."""

    stream: io.BufferedReader

    def makefile(self, _mode: str) -> io.BufferedReader:
        """Return the stream."""
        return self.stream


def _send_slice(sock: socket.socket, piece: FileSlice) -> None:
    """Send a slice with `sendfile` as far as possible; read and send the rest, and over TLS all of it."""
    sent = 0
    while sent < piece.length and not isinstance(sock, ssl.SSLSocket):
        try:
            count = os.sendfile(sock.fileno(), piece.handle, piece.offset + sent, piece.length - sent)
        except BlockingIOError:
            if not wait_for_write(sock, sock.gettimeout()):
                raise TimeoutError(f"the store took nothing for {sock.gettimeout():.0f} s") from None
            continue
        except OSError as error:
            if error.errno not in _SENDFILE_UNSUPPORTED:
                raise
            break
        if count == 0:
            break
        sent += count
    for view in piece.from_byte(sent).read():
        sock.sendall(view)


class StoreAnswer(enum.Enum):
    """What the client does after an answer of the store."""

    taken = enum.auto()
    try_again = enum.auto()
    sign_again = enum.auto()
    gone = enum.auto()
    refused = enum.auto()


@dataclass
class StoreResult:
    """The result of a request: `reason` and `code` are the store's, `error` that of the connection.

    `sent_bytes`: how much of a PUT's body was given to the network.
    """

    answer: StoreAnswer
    reason: str = ""
    code: str = ""
    error: BaseException | None = None
    sent_bytes: int = 0

    @property
    def why(self) -> str:
        """Why it failed, for people."""
        return reason_of(self.error) if self.error else self.reason or "it sends nothing"

    @property
    def is_store_wide(self) -> bool:
        """Whether requests for other objects would fail, too."""
        return self.error is not None or (self.answer is StoreAnswer.try_again and self.code in _STORE_WIDE_CODES)


@dataclass
class PutResult(StoreResult):
    """The result of a PUT."""

    etag: str = ""


@dataclass
class GetResult(StoreResult):
    """The result of a GET, with its bytes when the store gives them; must be closed."""

    response: urllib3.BaseHTTPResponse | None = None
    slice_bytes: int = _LEAST_SLICE_BYTES

    def slices(self) -> Iterator[bytes]:
        """Yield the bytes, in small slices from a slow link: an incomplete slice is lost with the connection.

        Raises:
            urllib3.exceptions.HTTPError: the connection ended early.
        """
        if self.response is None:
            return
        slice_bytes = least_bytes = min(_LEAST_SLICE_BYTES, self.slice_bytes)
        began_at = time.monotonic()
        while data := self.response.read(slice_bytes, decode_content=False):
            is_quick = time.monotonic() - began_at < _QUICK_SLICE_S
            slice_bytes = min(2 * slice_bytes, self.slice_bytes) if is_quick else max(slice_bytes // 2, least_bytes)
            yield data
            began_at = time.monotonic()
        self.response.release_conn()

    def close(self) -> None:
        """Drop what has not been read."""
        if self.response is not None:
            self.response.close()


class StoreClient:
    """Requests to object stores, over at most so many connections to each; nothing is tried twice."""

    def __init__(self, connections: int) -> None:
        timeout = urllib3.Timeout(connect=CONNECT_TIMEOUT_S, read=READ_TIMEOUT_S)
        self._connections = WatchedPools(_STORES, maxsize=connections, timeout=timeout)
        self._pools: dict[str, HTTPConnectionPool] = {}

    def close(self) -> None:
        """Close the connections."""
        self._connections.clear()

    def put(
        self, url: str, headers: Mapping[str, str], size_bytes: int, body: Iterable[FileSlice | bytes]
    ) -> PutResult:
        """PUT so many bytes to a signed URL, sent as they come from `body`. No redirect is followed."""
        scheme, _, rest = url.partition("://")
        host, _, target = rest.partition("/")
        store = f"{scheme}://{host}"
        if store not in self._pools:
            self._pools[store] = self._connections.connection_from_url(store)
        pool = self._pools[store]
        headers = {**headers, "Content-Length": str(size_bytes)}
        try:
            connection = cast("HTTPConnection", pool._get_conn())
            try:
                reply = _put(connection, f"/{target}", headers, body)
            except BaseException:
                connection.close()
                raise
            finally:
                pool._put_conn(connection)
        except (urllib3.exceptions.HTTPError, http.client.HTTPException, OSError) as error:
            return PutResult(StoreAnswer.try_again, error=error)
        # 412: an earlier try wrote it, and its answer was lost; the URL was signed for these bytes only.
        if reply.status < 300 or reply.status == 412:
            return PutResult(StoreAnswer.taken, etag=reply.etag.strip('"'))
        code = _code(reply.content)
        return PutResult(meaning(reply.status, code), _reason(reply.status, code), code)

    def get(self, url: str, first: int, last: int, slice_bytes: int) -> GetResult:
        """GET the bytes first..last, both inclusive; the result must be closed."""
        headers = {"Range": f"bytes={first}-{last}", "Accept-Encoding": "identity"}
        try:
            response = self._connections.request(
                "GET", url, headers=headers, redirect=False, preload_content=False, decode_content=False
            )
        except urllib3.exceptions.HTTPError as error:
            return GetResult(StoreAnswer.try_again, error=error)
        if response.status == 206 or (response.status == 200 and first == 0):
            return GetResult(StoreAnswer.taken, response=response, slice_bytes=slice_bytes)
        code = _code(response.read(2000))
        response.close()
        return GetResult(meaning(response.status, code), _reason(response.status, code), code)


def meaning(status: int, code: str) -> StoreAnswer:
    """Return the meaning of a status other than success, with the store's code for it ("" for none)."""
    if code in _GONE:
        return StoreAnswer.gone
    if status == 403:
        return StoreAnswer.sign_again
    # A 404 without a code is that of a proxy which does not reach the store.
    if status in {404, 408, 410, 429} or (status >= 500 and status not in _NOT_RETRIED) or code == "RequestTimeout":
        return StoreAnswer.try_again
    return StoreAnswer.refused


def _code(body: bytes) -> str:
    match = _CODE.search(body)
    return match.group(1).decode() if match else ""


def _reason(status: int, code: str) -> str:
    return f"the store answered {status} {code}".rstrip()
