"""S3 over HTTP, as little of it as this server speaks: one signed request, one answer, or one stream of bytes.

Knows nothing of uploads and recordings. Holds no object in memory: bodies sent and answers read whole are small. Why
this is no library: `docs/decisions/0011-own-s3-client.md`.

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

from kleinkram.server.settings import Settings
from kleinkram.server.signing import Presigner

READ_BYTES = 1024 * 1024
# What goes wrong on the way. A certificate that does not fit is among them, as a wrong address would be.
LOST = (aiohttp.ClientError, asyncio.TimeoutError, OSError)
# Signed requests are sent at once; the rest is for clocks that differ.
_GOOD_FOR_S = 900
_ATTEMPTS = 3
_FIRST_PAUSE_S = 0.2
_CLOCK_WITHIN_S = 2.0
_FORBIDDEN = 403
_PASSING = frozenset({429, 500, 502, 503, 504})
# What is answered in XML, where it is not an object's own bytes.
_TOLD = frozenset({"GET", "POST"})
_TIMEOUT = aiohttp.ClientTimeout(total=None, sock_connect=5, sock_read=60)
_CONNECTIONS = 32


class S3Error(Exception):
    """The store refused a request: `status`, the store's own code (the status where it gives none), its words."""

    def __init__(self, status: int, code: str, words: str) -> None:
        super().__init__(f"{code}: {words}")
        self.status = status
        self.code = code
        self.words = words


@dataclass(frozen=True)
class Question:
    """One request about the object `key`, or about the bucket where it is empty."""

    method: str
    key: str = ""
    query: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""


@dataclass(frozen=True)
class Answer:
    """What the store said: headers by name in small letters, and its XML, which it owes to GET and POST alone."""

    headers: Mapping[str, str]
    xml: ElementTree.Element | None

    def text(self, name: str) -> str:
        """Return the text of one element, empty where there is none."""
        return "" if self.xml is None else _text(self.xml, name)

    def entries(self, name: str) -> list[dict[str, str]]:
        """Return every element of that name as the texts of its children by name, in the store's order."""
        found = [] if self.xml is None else self.xml.findall(f"{{*}}{name}")
        return [{_local(child.tag): child.text or "" for child in element} for element in found]


class S3:
    """One bucket, and the connections to it. What passes by itself is tried three times."""

    def __init__(self, session: aiohttp.ClientSession, signer: Presigner) -> None:
        self._session = session
        self._signer = signer

    async def ask(self, question: Question) -> Answer:
        """Send a request and read the answer whole.

        Raises:
            S3Error: the store refused, was in trouble three times, or what answers is no store.
            aiohttp.ClientError, asyncio.TimeoutError, OSError: no connection, or no answer in time, three times.
        """
        async with self._opened(question) as response:
            xml = _xml(await response.read())
            # Source: CompleteMultipartUpload: an error may follow after a status of 200.
            if xml is not None and _local(xml.tag) == "Error":
                raise _error(500, xml)
            # A proxy's page is not an empty list, nor the word that parts were joined.
            if question.method in _TOLD and (xml is None or _local(xml.tag) == "html"):
                raise S3Error(response.status, "NoStoresAnswer", "what answers at the store's address is no S3 store")
            return Answer({name.lower(): value for name, value in response.headers.items()}, xml)

    async def stream(self, question: Question, *, attempts: int = _ATTEMPTS) -> AsyncGenerator[bytes, None]:
        """Yield the answer's body in pieces of at most 1 MiB; it ends early only by raising. Opened in so many tries.

        Raises:
            S3Error, aiohttp.ClientError, asyncio.TimeoutError, OSError: as `ask`; the last three also midway.
        """
        async with self._opened(question, attempts) as response:
            while piece := await response.content.read(READ_BYTES):
                yield piece

    async def look_at_clock(self) -> None:
        """Find out what time it is at the store, so that the first address is good; one that is away tells later."""

        async def look() -> None:
            async with self._opened(Question("HEAD")):
                pass

        with contextlib.suppress(S3Error, *LOST):
            await asyncio.wait_for(look(), _CLOCK_WITHIN_S)

    async def lets_page(self, origin: str, method: str) -> bool:
        """Ask without a signature, as browsers do, whether a page of `origin` may send such a request to an object.

        Source: Fetch Standard, "CORS-preflight fetch".

        Raises:
            aiohttp.ClientError, asyncio.TimeoutError, OSError: no connection, or no answer in time.
        """
        asked = {"Origin": origin, "Access-Control-Request-Method": method}
        url = self._signer.sign("OPTIONS", "preflight", query={}, headers={}, expires_s=_GOOD_FOR_S).partition("?")[0]
        async with self._session.options(URL(url, encoded=True), headers=asked, allow_redirects=False) as response:
            methods = {name.strip() for name in response.headers.get("Access-Control-Allow-Methods", "").split(",")}
            allowed = response.headers.get("Access-Control-Allow-Origin") in {origin, "*"}
            return response.status < 300 and allowed and bool(methods & {method, "*"})

    @asynccontextmanager
    async def _opened(self, question: Question, attempts: int = _ATTEMPTS) -> AsyncIterator[aiohttp.ClientResponse]:
        for attempt in range(1, attempts + 1):
            try:
                response = await self._send(question)
            except LOST:
                if attempt == attempts:
                    raise
            else:
                is_other_time = self._signer.clock.hear(response.headers.get("Date"))
                if is_other_time and response.status == _FORBIDDEN and attempt < attempts:
                    response.close()
                    continue  # signed for the wrong time
                if response.status not in _PASSING or attempt == attempts:
                    break
                response.close()
            await asyncio.sleep(_FIRST_PAUSE_S * 2 ** (attempt - 1) * random.uniform(0.5, 1.5))  # noqa: S311  (spreads load, hides nothing)
        async with response:
            if response.status >= 300:
                raise _error(response.status, _xml(await response.read()))
            yield response

    async def _send(self, question: Question) -> aiohttp.ClientResponse:
        url = self._signer.sign(
            question.method, question.key, query=question.query, headers=question.headers, expires_s=_GOOD_FOR_S
        )
        # Encoded: what was signed goes out as it is.
        return await self._session.request(
            question.method,
            URL(url, encoded=True),
            headers=question.headers,
            data=io.BytesIO(question.body) if question.body else None,
            allow_redirects=False,
        )


@asynccontextmanager
async def open_s3(settings: Settings, signer: Presigner) -> AsyncIterator[S3]:
    """Keep connections to the store for the life of a process."""
    trusted = ssl.create_default_context(cafile=str(settings.s3_ca_file)) if settings.s3_ca_file else True
    session = aiohttp.ClientSession(
        connector=aiohttp.TCPConnector(limit=_CONNECTIONS, ssl=trusted),
        timeout=_TIMEOUT,
        # Bytes are to come as they are stored.
        headers={"Accept-Encoding": "identity"},
        auto_decompress=False,
        skip_auto_headers=["Content-Type"],
        cookie_jar=aiohttp.DummyCookieJar(),
    )
    async with session:
        yield S3(session, signer)


def why(lost: BaseException) -> str:
    """Return what went wrong on the way, for people; never an address, which is a secret when signed."""
    if isinstance(lost, aiohttp.ClientSSLError):
        return "its certificate is not trusted, or it speaks no TLS (KLEINKRAM_S3_CA_FILE names who is trusted)"
    return type(lost).__name__


def _xml(body: bytes) -> ElementTree.Element | None:
    try:
        # While a store joins parts it may send white space, so that nobody thinks it is gone.
        return ElementTree.fromstring(body.strip())  # noqa: S314  (the store is ours; expat bounds what entities may become)
    except ElementTree.ParseError:
        return None


def _error(status: int, xml: ElementTree.Element | None) -> S3Error:
    code, words = ("", "") if xml is None else (_text(xml, "Code"), _text(xml, "Message"))
    return S3Error(status, code or str(status), words)


def _text(xml: ElementTree.Element, name: str) -> str:
    return xml.findtext(f"{{*}}{name}") or ""


def _local(tag: str) -> str:
    """An element's name without its namespace: stores differ in that."""
    return tag.rpartition("}")[2]
