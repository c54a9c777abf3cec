"""A minimal S3 client: sends one signed request and returns the response, or streams an object.

Independent of uploads and recordings. Never holds an object in memory: request bodies and parsed responses are small.
Why this is not a library: `docs/decisions/0011-own-s3-client.md`.

Source: Amazon S3 API Reference; errors as in its "Error responses".
"""

import asyncio
import contextlib
import io
import random
import ssl
from collections.abc import AsyncGenerator, AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from xml.etree import ElementTree

import aiohttp
from yarl import URL

from kleinkram.server import metrics
from kleinkram.server.s3.signing import Presigner
from kleinkram.server.settings import Settings

READ_BYTES = 1024 * 1024
CONNECTION_ERRORS = (aiohttp.ClientError, asyncio.TimeoutError, OSError)
"""No connection, no answer in time, or an untrusted certificate."""
_URL_LIFETIME_S = 900  # requests are sent at once; the rest allows for clocks that differ
_ATTEMPTS = 3
_FIRST_PAUSE_S = 0.2
_CLOCK_TIMEOUT_S = 2.0
_FORBIDDEN = 403
_TRANSIENT = frozenset({429, 500, 502, 503, 504})
# By method, whether the request is about an object, and the parameter of the query that distinguishes it.
# Source: Amazon S3 API Reference.
_OPERATIONS = {
    ("POST", True, "uploads"): "CreateMultipartUpload",
    ("POST", True, "uploadId"): "CompleteMultipartUpload",
    ("DELETE", True, "uploadId"): "AbortMultipartUpload",
    ("PUT", True, "uploadId"): "UploadPart",
    ("GET", True, "uploadId"): "ListParts",
    ("GET", False, "uploads"): "ListMultipartUploads",
    ("GET", False, "list-type"): "ListObjectsV2",
    ("PUT", False, "cors"): "PutBucketCors",
    ("PUT", False, ""): "CreateBucket",
    ("HEAD", False, ""): "HeadBucket",
    ("HEAD", True, ""): "HeadObject",
    ("GET", True, ""): "GetObject",
    ("PUT", True, ""): "PutObject",
    ("DELETE", True, ""): "DeleteObject",
}
_DISTINCTIVE = ("uploadId", "uploads", "list-type", "cors")
_METHODS_WITH_XML = frozenset({"GET", "POST"})
_TIMEOUT = aiohttp.ClientTimeout(total=None, sock_connect=5, sock_read=60)
_CONNECTIONS = 32


class S3Error(Exception):
    """The store refused a request: HTTP `status`, the store's error code (the status if it sent none), its message."""

    def __init__(self, status: int, code: str, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.status = status
        self.code = code
        self.message = message


@dataclass(frozen=True)
class S3Request:
    """One request about the object `key`, or about the bucket if `key` is empty."""

    method: str
    key: str = ""
    query: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""

    @property
    def operation(self) -> str:
        """The name of the operation in the S3 API; the method for a request of another kind."""
        parameter = next((name for name in _DISTINCTIVE if name in self.query), "")
        return _OPERATIONS.get((self.method, bool(self.key), parameter), self.method)


@dataclass(frozen=True)
class S3Response:
    """The store's answer: headers by lower-case name, and its XML, which only GET and POST must return."""

    headers: Mapping[str, str]
    xml: ElementTree.Element | None

    def text(self, name: str) -> str:
        """Return the text of one element; empty if there is none."""
        return "" if self.xml is None else _text(self.xml, name)

    def entries(self, name: str) -> list[dict[str, str]]:
        """Return every element of a name, in the store's order, as a map from child name to child text."""
        elements = [] if self.xml is None else self.xml.findall(f"{{*}}{name}")
        return [{_local_name(child.tag): child.text or "" for child in element} for element in elements]


class S3Client:
    """Connections to one bucket. Transient failures are retried, at most three attempts."""

    def __init__(self, session: aiohttp.ClientSession, signer: Presigner) -> None:
        self._session = session
        self._signer = signer

    async def request(self, request: S3Request) -> S3Response:
        """Send a request and read the whole answer.

        Raises:
            S3Error: the store refused, failed in every attempt, or the server that answered is no S3 store.
            aiohttp.ClientError, asyncio.TimeoutError, OSError: no connection or no answer in any attempt.
        """
        async with self._open(request) as response:
            xml = _parse_xml(await response.read())
            # Source: CompleteMultipartUpload: an error may follow a status of 200.
            if xml is not None and _local_name(xml.tag) == "Error":
                raise _error(500, xml)
            # A proxy's error page is neither an empty list nor a confirmation that parts were joined.
            if request.method in _METHODS_WITH_XML and (xml is None or _local_name(xml.tag) == "html"):
                raise S3Error(response.status, "NotAStore", "the server at the store's address is no S3 store")
            return S3Response({name.lower(): value for name, value in response.headers.items()}, xml)

    async def stream(self, request: S3Request, *, attempts: int = _ATTEMPTS) -> AsyncGenerator[bytes, None]:
        """Yield the answer's body in chunks of at most 1 MiB; an incomplete body raises. `attempts` to open it.

        Raises:
            S3Error, aiohttp.ClientError, asyncio.TimeoutError, OSError: as `request`; the last three also midway.
        """
        async with self._open(request, attempts) as response:
            while chunk := await response.content.read(READ_BYTES):
                metrics.STORE_READ_BYTES.inc(len(chunk))
                yield chunk

    async def read_clock(self) -> None:
        """Learn the store's time, so that the first URL is valid. An unreachable store is ignored here."""

        async def read() -> None:
            async with self._open(S3Request("HEAD")):
                pass

        with contextlib.suppress(S3Error, *CONNECTION_ERRORS):
            await asyncio.wait_for(read(), _CLOCK_TIMEOUT_S)

    async def allows_page(self, origin: str, method: str) -> bool:
        """Send a CORS preflight, unsigned as browsers do: may a page of `origin` send this method to an object?

        Source: Fetch Standard, "CORS-preflight fetch".

        Raises:
            aiohttp.ClientError, asyncio.TimeoutError, OSError: no connection, or no answer in time.
        """
        headers = {"Origin": origin, "Access-Control-Request-Method": method}
        signed = self._signer.sign("OPTIONS", "preflight", query={}, headers={}, expires_s=_URL_LIFETIME_S)
        url = URL(signed.partition("?")[0], encoded=True)
        async with self._session.options(url, headers=headers, allow_redirects=False) as response:
            methods = {name.strip() for name in response.headers.get("Access-Control-Allow-Methods", "").split(",")}
            is_origin_allowed = response.headers.get("Access-Control-Allow-Origin") in {origin, "*"}
            return response.status < 300 and is_origin_allowed and bool(methods & {method, "*"})

    @asynccontextmanager
    async def _open(self, request: S3Request, attempts: int = _ATTEMPTS) -> AsyncIterator[aiohttp.ClientResponse]:
        for attempt in range(1, attempts + 1):
            is_last = attempt == attempts
            try:
                response = await self._send(request)
            except CONNECTION_ERRORS:
                if is_last:
                    raise
            else:
                has_clock_changed = self._signer.clock.adjust(response.headers.get("Date"))
                metrics.STORE_CLOCK_OFFSET_SECONDS.set(self._signer.clock.offset_s)
                if has_clock_changed and response.status == _FORBIDDEN and not is_last:
                    response.close()
                    continue  # it was signed for the wrong time
                if response.status not in _TRANSIENT or is_last:
                    break
                response.close()
            await asyncio.sleep(_FIRST_PAUSE_S * 2 ** (attempt - 1) * random.uniform(0.5, 1.5))  # noqa: S311  jitter
        async with response:
            if response.status >= 300:
                raise _error(response.status, _parse_xml(await response.read()))
            yield response

    async def _send(self, request: S3Request) -> aiohttp.ClientResponse:
        url = self._signer.sign(
            request.method, request.key, query=request.query, headers=request.headers, expires_s=_URL_LIFETIME_S
        )
        outcome = "cancelled"
        try:
            with metrics.STORE_REQUEST_SECONDS.labels(request.operation).time():
                response = await self._session.request(
                    request.method,
                    URL(url, encoded=True),  # exactly what was signed
                    headers=request.headers,
                    data=io.BytesIO(request.body) if request.body else None,
                    allow_redirects=False,
                )
            outcome = {4: "refused", 5: "failed"}.get(response.status // 100, "succeeded")
        except CONNECTION_ERRORS:
            outcome = "unreachable"
            raise
        else:
            return response
        finally:
            metrics.STORE_REQUESTS.labels(request.operation, outcome).inc()


@asynccontextmanager
async def open_s3(
    settings: Settings, signer: Presigner, client_class: type[S3Client] = S3Client
) -> AsyncIterator[S3Client]:
    """Open a client for the life of a process."""
    tls = ssl.create_default_context(cafile=str(settings.s3_ca_file)) if settings.s3_ca_file else True
    session = aiohttp.ClientSession(
        connector=aiohttp.TCPConnector(limit=_CONNECTIONS, ssl=tls),
        timeout=_TIMEOUT,
        headers={"Accept-Encoding": "identity"},  # bytes must arrive as they are stored
        auto_decompress=False,
        skip_auto_headers=["Content-Type"],
        cookie_jar=aiohttp.DummyCookieJar(),
    )
    async with session:
        yield client_class(session, signer)


def describe_connection_error(error: BaseException) -> str:
    """Return why a connection failed, for people; never a URL, which is a secret when signed."""
    if is_certificate_error(error):
        # Both kinds have the cause: that which connecting raises, and OpenSSL's own.
        cause = getattr(error, "certificate_error", error)
        return f"its certificate is refused: {getattr(cause, 'verify_message', '') or 'unknown reason'}"
    if isinstance(error, (aiohttp.ClientSSLError, ssl.SSLError)):
        return "it does not speak TLS: its address may begin with http://"
    if isinstance(error, aiohttp.ServerDisconnectedError):
        return "it closed the connection"
    return getattr(error, "strerror", None) or type(error).__name__


def is_certificate_error(error: BaseException) -> bool:
    """Whether a connection failed because the server's certificate is not trusted, expired, or of another name."""
    return isinstance(error, (aiohttp.ClientConnectorCertificateError, ssl.SSLCertVerificationError))


def _parse_xml(body: bytes) -> ElementTree.Element | None:
    try:
        # A store may send white space while it joins parts, to keep the connection alive.
        return ElementTree.fromstring(body.strip())  # noqa: S314  (our own store; expat bounds entity expansion)
    except ElementTree.ParseError:
        return None


def _error(status: int, xml: ElementTree.Element | None) -> S3Error:
    code, message = ("", "") if xml is None else (_text(xml, "Code"), _text(xml, "Message"))
    return S3Error(status, code or str(status), message)


def _text(xml: ElementTree.Element, name: str) -> str:
    return xml.findtext(f"{{*}}{name}") or ""


def _local_name(tag: str) -> str:
    """Return an element's name without its namespace: stores differ in that."""
    return tag.rpartition("}")[2]
