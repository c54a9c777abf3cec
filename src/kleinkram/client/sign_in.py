"""Signing in by a browser that returns to a port of 127.0.0.1 (RFC 8252), or by a code typed elsewhere (RFC 8628).

Any program on this machine can connect to that port; only a request with the login's `state` is accepted.
"""

import base64
import hashlib
import queue
import secrets
import socketserver
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from types import TracebackType
from urllib.parse import parse_qs, urlencode, urlsplit

from typing_extensions import Self

from kleinkram.client._http import Api
from kleinkram.client.config import Endpoint, EndpointSource, normal_url
from kleinkram.client.errors import ServerUnreachable
from kleinkram.client.server import Me
from kleinkram.contract.accounts import CliExchange, DeviceBegin, DeviceCode, DeviceExchange, MeRead, SignedIn
from kleinkram.contract.errors import (
    NotAuthenticated,
    RateLimited,
    SignInDenied,
    SignInExpired,
    SignInPending,
    SlowDown,
)

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Kleinkram</title></head>
<body style="font-family: sans-serif; max-width: 32em; margin: 4em auto"><h1>{title}</h1><p>{text}</p></body></html>
"""
_HEADERS = {
    "Content-Type": "text/html; charset=utf-8",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Connection": "close",
}
# Browsers open connections ahead of time and send nothing on them.
_SILENCE_S = 10.0


class _Denied:
    """The person refused."""


class Loopback:
    """A port of 127.0.0.1 at which one login waits for its browser. A context manager."""

    def __init__(self, state: str) -> None:
        self._results: queue.SimpleQueue[str | _Denied] = queue.SimpleQueue()
        self._server = _LoopbackServer(("127.0.0.1", 0), _listener(state, self._results))
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self.port: int = self._server.server_address[1]

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def wait(self, timeout_s: float) -> str:
        """Return the code of the browser; SignInDenied if the person refused, SignInExpired if none came in time."""
        try:
            result = self._results.get(timeout=timeout_s)
        except queue.Empty:
            raise SignInExpired from None
        if isinstance(result, _Denied):
            raise SignInDenied
        return result


class _LoopbackServer(socketserver.ThreadingTCPServer):
    """A thread per connection, so that a silent one blocks no other."""

    daemon_threads = True


def _listener(state: str, results: "queue.SimpleQueue[str | _Denied]") -> type[BaseHTTPRequestHandler]:
    class Listener(BaseHTTPRequestHandler):
        timeout = _SILENCE_S

        def do_GET(self) -> None:
            target = urlsplit(self.path)
            parameters = {name: values[0] for name, values in parse_qs(target.query).items()}
            if target.path != "/":
                self._answer(HTTPStatus.NOT_FOUND, "Nothing here", "klein waits at another address.")
            elif not secrets.compare_digest(parameters.get("state", "").encode(), state.encode()):
                self._answer(HTTPStatus.BAD_REQUEST, "Not signed in", "This belongs to no login that klein waits for.")
            elif code := parameters.get("code"):
                self._answer(HTTPStatus.OK, "Back to the terminal", "klein has what it needs. Close this window.")
                results.put(code)
            else:
                self._answer(HTTPStatus.OK, "Not signed in", "You refused the sign-in of klein. Close this window.")
                results.put(_Denied())

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002  the name that http.server gives it
            """Log nothing: the query holds a code."""

        def _answer(self, status: HTTPStatus, title: str, text: str) -> None:
            page = _PAGE.format(title=title, text=text).encode()
            self.send_response(status)
            for name, value in {**_HEADERS, "Content-Length": str(len(page))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(page)

    return Listener


# How long a person may take in the browser; the server's codes expire then.
BROWSER_TIMEOUT_S = 300.0
_LONGEST_INTERVAL_S = 60.0


@dataclass(frozen=True)
class BrowserLogin:
    """A login that waits for a browser, which must open `url`."""

    url: str
    _server: str
    _verifier: str = field(repr=False)
    _loopback: Loopback = field(repr=False)

    def wait(self, timeout_s: float = BROWSER_TIMEOUT_S) -> SignedIn:
        """Wait until the page has sent the browser back, and exchange its code for a token.

        Raises:
            SignInDenied: the person refused.
            SignInExpired: no code came in time, or it has expired.
        """
        code = self._loopback.wait(timeout_s)
        with _connection(self._server) as api:
            return api.send("POST", "/auth/cli/token", SignedIn, CliExchange(code=code, code_verifier=self._verifier))


@contextmanager
def begin_browser(url: str, client: str) -> Iterator[BrowserLogin]:
    """Listen on this machine's loopback for a browser, for as long as the context lasts.

    `client` is shown on the page and becomes the name of the token.
    """
    server, state, verifier = normal_url(url), secrets.token_urlsafe(32), secrets.token_urlsafe(64)
    digest = hashlib.sha256(verifier.encode()).digest()
    challenge = base64.urlsafe_b64encode(digest).decode().rstrip("=")
    with Loopback(state) as loopback:
        query = {"port": loopback.port, "state": state, "code_challenge": challenge, "client": client}
        yield BrowserLogin(f"{server}/sign-in/cli?{urlencode(query)}", server, verifier, loopback)


def begin_device(url: str, client: str) -> DeviceCode:
    """Ask a server for a code that can be typed on any machine with a browser."""
    with _connection(normal_url(url)) as api:
        return api.send("POST", "/auth/device", DeviceCode, DeviceBegin(client=client))


def wait_for_device(url: str, code: DeviceCode, wait: Callable[[float], object] = time.sleep) -> SignedIn:
    """Poll until the code was typed, no more often than the server allows, also while it is unreachable.

    Raises:
        SignInDenied: the person refused.
        SignInExpired: the code was not typed in time.
    """
    interval_s, left_s = code.interval_s, code.expires_s
    with _connection(normal_url(url)) as api:
        while left_s > 0:
            wait(interval_s)
            left_s -= interval_s
            try:
                return api.send("POST", "/auth/device/token", SignedIn, DeviceExchange(device_code=code.device_code))
            except SignInPending as pending:
                interval_s = max(interval_s, pending.interval_s)
            except SlowDown as slower:
                interval_s = max(interval_s, slower.interval_s)
            except RateLimited as limited:
                wait(limited.retry_after_s)
                left_s -= limited.retry_after_s
            except ServerUnreachable:
                interval_s = min(interval_s * 2, _LONGEST_INTERVAL_S)
    raise SignInExpired


def who_has(url: str, token: str) -> MeRead:
    """Return the account of a token."""
    with _connection(normal_url(url), token) as api:
        return Me(api).get()


def end_token(url: str, token: str) -> bool:
    """Revoke a token at its server; False where it was not valid already."""
    with _connection(normal_url(url), token) as api:
        try:
            Me(api).sign_out()
        except NotAuthenticated:
            return False
    return True


def check_server(url: str) -> None:
    """Raise ServerUnreachable or AnswerNotUnderstood unless a Kleinkram server answers."""
    with _connection(normal_url(url)) as api, suppress(NotAuthenticated):
        Me(api).get()


@contextmanager
def _connection(url: str, token: str | None = None) -> Iterator[Api]:
    api = Api(Endpoint("(given)", url, token, EndpointSource.argument))
    try:
        yield api
    finally:
        api.close()
