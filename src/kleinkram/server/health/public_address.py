"""Checks the public addresses as clients meet them, for `check`: certificates, proxies' headers and limits, the store.

Sends no more than headers and one small object; the API reports to `check` how its requests arrive.
"""

import asyncio
import contextlib
import datetime
import ssl
import time
import uuid
from collections.abc import AsyncIterator
from dataclasses import dataclass
from urllib.parse import urlsplit

import aiohttp
from pydantic import ValidationError
from yarl import URL

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.reports import MAX_REPORT_BODY_BYTES
from kleinkram.diagnostics import Diagnostic, DiagnosticSeverity, judge, ok, problem, warning
from kleinkram.server.http.headers import CHECK_HEADER, EVENT_STREAM, RequestOrigin, is_trusted, operator_code
from kleinkram.server.s3.client import CONNECTION_ERRORS, describe_connection_error, is_certificate_error
from kleinkram.server.s3.storage import PartTarget, Storage, StoreRefused
from kleinkram.server.settings import Settings

_TIMEOUT = aiohttp.ClientTimeout(total=15)
# Of a network for documentation (RFC 5737): no client has it.
_FORGED = "192.0.2.77"
# The API ends its answer later than this.
_EVENT_TIMEOUT_S = 2.0
_PART_BYTES = 64 * 1024**2
_CERTIFICATE_DAYS = 14
_REDIRECTS = range(300, 400)
_UNAVAILABLE = frozenset({502, 503, 504})
_HEADERS = "proxy headers"


@dataclass(frozen=True)
class _HttpAnswer:
    """Status, location and start of the body of an answer."""

    status: int
    location: str
    text: str


@dataclass(frozen=True)
class _LargeRequest:
    """Whether a proxy refuses a large request, and until when its certificate is valid."""

    is_refused: bool
    certificate_ends: datetime.datetime | None


async def check_public_address(settings: Settings) -> AsyncIterator[Diagnostic]:
    """Check the API's public address: whether it leads to the API, and what the proxy does to requests."""
    check, url = "public address", settings.public_url.rstrip("/")
    code = {CHECK_HEADER: operator_code(settings)}
    forged_headers = {"X-Forwarded-For": _FORGED, "X-Forwarded-Proto": "http"}
    try:
        async with _open_session() as session:
            live = await _get(session, f"{url}/health/live", code)
            if (fault := _not_api(url, live)) is not None:
                yield fault
                return
            forged = await _get(session, f"{url}/health/live", {**code, **forged_headers})
            metrics = await _get(session, f"{url}/metrics")
            is_prompt = await _gets_events(session, f"{url}/health/live", code)
        large = await _send_large_request(url, "POST", "/api/v1/runner/runs/check/finish", MAX_REPORT_BODY_BYTES)
    except CONNECTION_ERRORS as error:
        yield _unreachable(check, url, error, "Start the API and the proxy, or correct KLEINKRAM_PUBLIC_URL.")
        return
    yield ok(check, f"The API answers at {url}.")
    if large.certificate_ends is not None:
        yield _certificate(large.certificate_ends)
    yield _metrics(metrics)
    try:
        origins = [RequestOrigin.model_validate_json(answer.text) for answer in (live, forged)]
    except ValidationError:
        yield warning(_HEADERS, "Not checked: the API has other settings, or is of another version.")
        return
    yield _proxy(settings, *origins)
    yield _report_size(large)
    yield _event_streams(is_prompt)


async def check_public_store(settings: Settings, storage: Storage) -> AsyncIterator[Diagnostic]:
    """Check the store's public address: whether signed URLs work there, and parts of files pass."""
    check, url = "public address of the store", settings.store_public_url
    if settings.public_url.startswith("https://") and not url.startswith("https://"):
        message = f"{url} is not encrypted, and {settings.public_url} is: browsers refuse to upload and preview."
        yield problem(check, message, "Serve it by https, and set KLEINKRAM_S3_PUBLIC_URL.")
    key, body = f"probe/{uuid.uuid4()}", uuid.uuid4().hex
    part = PartTarget(key, None, 1, _PART_BYTES, "00" * 16)
    try:
        await storage.put_object(key, body.encode())
        try:
            async with _open_session() as session:
                answer = await _get(session, storage.sign_get(key, path="check", expires_s=60))
            target = storage.sign_part(part, expires_s=60).url.removeprefix(_origin(url))
            large = await _send_large_request(_origin(url), "PUT", target, _PART_BYTES)
        finally:
            await storage.delete(key)
    except (StoreUnavailable, StoreRefused):
        return  # `check` has reported that the store cannot be written
    except CONNECTION_ERRORS as error:
        yield _unreachable(check, url, error, "Start the proxy, or correct KLEINKRAM_S3_PUBLIC_URL.")
        return
    yield _signed(check, url, answer, body)
    if large.is_refused:
        message = f"The proxy of the store refuses parts of {_PART_BYTES // 1024**2} MiB."
        yield problem("size of parts", message, "Let it pass on bodies of any size (nginx: client_max_body_size 0).")


def _not_api(url: str, live: _HttpAnswer) -> Diagnostic | None:
    check = "public address"
    if live.status in _REDIRECTS:
        remedy = "Set KLEINKRAM_PUBLIC_URL to the address that clients use, without redirects."
        return problem(check, f"{url} redirects to {live.location}.", remedy)
    if live.status in _UNAVAILABLE:
        message = f"The proxy at {url} answers {live.status}: it does not reach the API."
        return problem(check, message, "Start the API, or correct its address in the proxy's configuration.")
    if live.status != 200:
        return problem(check, f"{url}/health/live answers {live.status}.", "Let the proxy pass it on to the API.")
    if live.text != "live\n" and not live.text.startswith("{"):
        remedy = "Let the proxy pass on all requests, or correct KLEINKRAM_PUBLIC_URL."
        return problem(check, f"Another server than the API answers at {url}.", remedy)
    return None


def _unreachable(check: str, url: str, error: BaseException, remedy: str) -> Diagnostic:
    message = f"{url} cannot be reached from here: {describe_connection_error(error)}."
    if is_certificate_error(error):
        remedy = "Install a certificate for this name; for a private authority, set SSL_CERT_FILE here and at clients."
        return problem(check, message, remedy)
    return warning(check, message, remedy)


def _certificate(ends: datetime.datetime) -> Diagnostic:
    left = ends - datetime.datetime.now(datetime.timezone.utc)
    is_new = left >= datetime.timedelta(days=_CERTIFICATE_DAYS)
    return judge(
        "certificate", is_new, f"Valid until {ends:%Y-%m-%d}.", "Renew it.", otherwise=DiagnosticSeverity.warning
    )


def _metrics(answer: _HttpAnswer) -> Diagnostic:
    check = "metrics not public"
    if answer.status == 200 and "kleinkram_" in answer.text:
        return problem(check, "They are served at the public address.", "Let the proxy answer 404 for /metrics.")
    return ok(check, "They are not served at the public address.")


def _proxy(settings: Settings, origin: RequestOrigin, forged: RequestOrigin) -> Diagnostic:
    """Judge how a request arrived, and how another one arrived that claimed to come from `_FORGED`, by http."""
    trusted = settings.trusted_proxies
    if any(network.prefixlen == 0 for network in trusted):
        message = "KLEINKRAM_TRUSTED_PROXIES has all addresses: every client can claim another's."
        return problem(_HEADERS, message, "Set it to the addresses of the proxies.")
    is_remote = not is_local(urlsplit(settings.public_url).hostname)
    if not origin.forwarded_for and is_remote and (is_local(origin.peer) or is_trusted(origin.peer, trusted)):
        return problem(
            _HEADERS,
            f"The proxy does not send X-Forwarded-For: all requests seem to come from {origin.peer}.",
            "Configure it to send the header, and set KLEINKRAM_TRUSTED_PROXIES: see docs/running.md.",
        )
    if origin.forwarded_for and forged.forwarded_for == (_FORGED,):
        message = "The proxy passes on X-Forwarded-For of clients, who can claim any address."
        return problem(_HEADERS, message, "Let it set the header, or add the client's address: see docs/running.md.")
    if origin.forwarded_for and origin.address != origin.forwarded_for[0]:
        return problem(
            _HEADERS,
            f"The API does not trust the proxy at {origin.address}: all requests seem to come from one address.",
            f"Add {origin.address}, or the proxy's network, to KLEINKRAM_TRUSTED_PROXIES.",
        )
    if settings.public_url.startswith("https://") and "http" in {origin.scheme, forged.scheme}:
        message = "The API takes https for http" + (", if a client says so." if origin.scheme == "https" else ".")
        return problem(_HEADERS, message, "Let the proxy set X-Forwarded-Proto.")
    if is_remote and origin.address != origin.peer and is_trusted(origin.address, trusted):
        message = f"KLEINKRAM_TRUSTED_PROXIES has {origin.address}, where this command runs: is it a proxy?"
        return warning(_HEADERS, message, "Set it to the addresses of the proxies: others can claim any address.")
    return ok(_HEADERS, f"The API sees requests from here as {origin.address}, by {origin.scheme}.")


def _report_size(large: _LargeRequest) -> Diagnostic:
    check, size = "size of requests", f"{MAX_REPORT_BODY_BYTES // 1024**2} MiB"
    if large.is_refused:
        remedy = "Raise its limit (nginx: client_max_body_size 33m)."
        return problem(check, f"The proxy refuses requests of {size}, which reports of runs may have.", remedy)
    return ok(check, f"Requests of {size} reach the API.")


def _event_streams(is_prompt: bool) -> Diagnostic:
    check = "event streams"
    if not is_prompt:
        remedy = "Let it not buffer responses (nginx: proxy_buffering off, or respect X-Accel-Buffering)."
        return problem(check, "The proxy holds events back: pages do not learn of changes.", remedy)
    return ok(check, "Events arrive at once.")


def _signed(check: str, url: str, answer: _HttpAnswer, body: str) -> Diagnostic:
    if answer.status == 200 and answer.text == body:
        return ok(check, f"Signed URLs work at {url}.")
    if "SignatureDoesNotMatch" in answer.text:
        message = f"The store refuses URLs that are signed for {url}: a proxy changes Host, path or query."
        return problem(check, message, "Let it pass on all three (nginx: proxy_set_header Host $http_host).")
    message = f"{url} does not lead to the bucket: a signed URL answers {answer.status}."
    return problem(check, message, "Correct KLEINKRAM_S3_PUBLIC_URL, or let the proxy pass on the bucket's path.")


def _open_session() -> aiohttp.ClientSession:
    # A context of its own: that of aiohttp may be older than SSL_CERT_FILE.
    connector = aiohttp.TCPConnector(ssl=ssl.create_default_context())
    return aiohttp.ClientSession(connector=connector, timeout=_TIMEOUT)


async def _get(session: aiohttp.ClientSession, url: str, headers: dict[str, str] | None = None) -> _HttpAnswer:
    async with session.get(URL(url, encoded=True), headers=headers, allow_redirects=False) as response:
        text = (await response.content.read(65_536)).decode(errors="replace")
        _cut(response)
        return _HttpAnswer(response.status, response.headers.get("Location", "nowhere"), text)


def _cut(response: aiohttp.ClientResponse) -> None:
    """End a connection whose response has not ended, without the farewell of TLS, which outlasts the event loop."""
    if response.connection is not None and response.connection.transport is not None:
        response.connection.transport.abort()


async def _gets_events(session: aiohttp.ClientSession, url: str, headers: dict[str, str]) -> bool:
    """Whether the first event of a stream arrives before the API ends the stream."""
    started = time.monotonic()
    accepting = {**headers, "Accept": EVENT_STREAM}
    async with session.get(URL(url, encoded=True), headers=accepting, allow_redirects=False) as response:
        await response.content.readline()
        _cut(response)
    return time.monotonic() - started < _EVENT_TIMEOUT_S


async def _send_large_request(url: str, method: str, path: str, size_bytes: int) -> _LargeRequest:
    """Send the headers of a request with a body of this size, and nothing of the body.

    The API's own refusals are problem documents. Some servers answer once they have the body, and so not at all.
    """
    parts = urlsplit(url)
    is_https = parts.scheme == "https"
    tls = ssl.create_default_context() if is_https else None
    port = parts.port or (443 if is_https else 80)
    head = f"{method} {parts.path}{path} HTTP/1.1\r\nHost: {parts.netloc}\r\nContent-Length: {size_bytes}\r\n"
    reader, writer = await asyncio.wait_for(asyncio.open_connection(parts.hostname, port, ssl=tls), _EVENT_TIMEOUT_S)
    certificate = writer.get_extra_info("peercert")
    ends_s = ssl.cert_time_to_seconds(certificate["notAfter"]) if certificate else None
    ends = None if ends_s is None else datetime.datetime.fromtimestamp(ends_s, datetime.timezone.utc)
    try:
        writer.write(f"{head}Content-Type: application/json\r\nExpect: 100-continue\r\n\r\n".encode())
        answer = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _EVENT_TIMEOUT_S)
    except (asyncio.TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, ConnectionResetError):
        return _LargeRequest(is_refused=False, certificate_ends=ends)
    finally:
        writer.transport.abort()  # nobody waits for the body
        with contextlib.suppress(*CONNECTION_ERRORS):
            await writer.wait_closed()
    is_too_large = answer.partition(b"\r\n")[0].split(b" ")[1:2] == [b"413"]
    return _LargeRequest(is_too_large and b"application/problem+json" not in answer, ends)


def _origin(url: str) -> str:
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.netloc.lower()}"


def is_local(host: str | None) -> bool:
    """Whether an address is this machine's loopback."""
    return host in {"localhost", "127.0.0.1", "::1"}
