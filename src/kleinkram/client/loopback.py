"""Where a browser comes back to after signing in: a port of 127.0.0.1, for as long as one login takes (RFC 8252).

Any program or page on this machine can knock there; only who brings the login's `state` is listened to.
"""

import queue
import secrets
import socketserver
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from types import TracebackType
from urllib.parse import parse_qs, urlsplit

from typing_extensions import Self

from kleinkram.contract.errors import SignInDenied, SignInExpired

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
# Browsers open connections ahead of time and say nothing on them.
_SILENCE_S = 10.0


class _Denied:
    """The person refused."""


class Loopback:
    """A port of 127.0.0.1 at which one login waits for its browser. A context manager."""

    def __init__(self, state: str) -> None:
        self._came: queue.SimpleQueue[str | _Denied] = queue.SimpleQueue()
        self._server = _Server(("127.0.0.1", 0), _listener(state, self._came))
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
        """Return the code that the browser brings.

        Raises:
            SignInDenied: it says that the person refused.
            SignInExpired: none came in time.
        """
        try:
            came = self._came.get(timeout=timeout_s)
        except queue.Empty:
            raise SignInExpired from None
        if isinstance(came, _Denied):
            raise SignInDenied
        return came


class _Server(socketserver.ThreadingTCPServer):
    """A thread a connection, so that a silent one keeps nobody waiting."""

    daemon_threads = True


def _listener(state: str, came: "queue.SimpleQueue[str | _Denied]") -> type[BaseHTTPRequestHandler]:
    class Listener(BaseHTTPRequestHandler):
        timeout = _SILENCE_S

        def do_GET(self) -> None:
            target = urlsplit(self.path)
            said = {name: values[0] for name, values in parse_qs(target.query).items()}
            if target.path != "/":
                self._answer(HTTPStatus.NOT_FOUND, "Nothing here", "klein waits at another address.")
            elif not secrets.compare_digest(said.get("state", "").encode(), state.encode()):
                self._answer(HTTPStatus.BAD_REQUEST, "Not signed in", "This belongs to no login that klein waits for.")
            elif code := said.get("code"):
                self._answer(HTTPStatus.OK, "Back to the terminal", "klein has what it needs. Close this window.")
                came.put(code)
            else:
                self._answer(HTTPStatus.OK, "Not signed in", "klein was told no. Close this window.")
                came.put(_Denied())

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002  the name that http.server gives it
            """Say nothing: the query holds a code, and the terminal belongs to klein."""

        def _answer(self, status: HTTPStatus, title: str, text: str) -> None:
            page = _PAGE.format(title=title, text=text).encode()
            self.send_response(status)
            for name, value in {**_HEADERS, "Content-Length": str(len(page))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(page)

    return Listener
