"""A proxy in front of a real store that refuses, delays or drops responses.

Requests are passed on byte for byte, with the caller's Host, so signatures hold at the store behind.
"""

import datetime
import http.client
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from email.utils import format_datetime
from http.server import BaseHTTPRequestHandler
from urllib.parse import parse_qsl, urlsplit

from tests.http_server import QuietHandler, serving

_OF_ONE_HOP = {"connection", "transfer-encoding", "keep-alive", "expect"}


@dataclass(frozen=True)
class ProxiedRequest:
    """One request to the store; names of headers in lower case."""

    method: str
    key: str
    query: Mapping[str, str]
    headers: Mapping[str, str]


@dataclass(frozen=True)
class Reply:
    """An answer that is not the store's: with an S3 error code, or without one, as a proxy's own page."""

    status: int
    code: str | None = None

    @property
    def body(self) -> bytes:
        """What stands in it."""
        if self.code is None:
            return f"<html><h1>{self.status}</h1></html>".encode()
        return f"<?xml version='1.0'?><Error><Code>{self.code}</Code><Message>said</Message></Error>".encode()


@dataclass(frozen=True)
class Lost:
    """The store gets the request and does it; its answer never arrives."""


@dataclass(frozen=True)
class Cut:
    """The store's answer breaks off in the middle of its body."""


Rule = Callable[[ProxiedRequest], "Reply | Lost | Cut | None"]
Edit = Callable[[ProxiedRequest, bytes], bytes]


class Middleman:
    """Stands before a store, at `url`.

    `rule` says what becomes of each request: None lets it through. `edit` may change what an answer says. Its clock is
    `ahead` of this machine's.
    """

    def __init__(self, url: str, store: str) -> None:
        self.url = url
        self.rule: Rule = lambda _proxied: None
        self.edit: Edit = lambda _proxied, body: body
        self.ahead = datetime.timedelta(0)
        self._store = urlsplit(store).netloc

    def pass_on(self, request: BaseHTTPRequestHandler) -> None:
        """Deal with one request."""
        target = urlsplit(request.path)
        headers = {name.lower(): value for name, value in request.headers.items()}
        body = request.rfile.read(int(headers.get("content-length", 0)))
        query = dict(parse_qsl(target.query, keep_blank_values=True))
        proxied = ProxiedRequest(request.command, target.path.split("/", 2)[-1], query, headers)
        decided = self.rule(proxied)
        if isinstance(decided, Reply):
            _answer(request, decided.status, {"content-type": "application/xml"}, decided.body)
            return
        status, answered, content = self._ask_store(request, headers, body)
        if self.ahead:
            answered["date"] = format_datetime(datetime.datetime.now(datetime.timezone.utc) + self.ahead, usegmt=True)
        if isinstance(decided, Lost):
            request.close_connection = True
            return
        if isinstance(decided, Cut):
            request.close_connection = True
        _answer(request, status, answered, self.edit(proxied, content), cut=isinstance(decided, Cut))

    def _ask_store(
        self, request: BaseHTTPRequestHandler, headers: Mapping[str, str], body: bytes
    ) -> tuple[int, dict[str, str], bytes]:
        connection = http.client.HTTPConnection(self._store, timeout=30)
        try:
            connection.putrequest(request.command, request.path, skip_host=True, skip_accept_encoding=True)
            for name, value in headers.items():
                if name not in _OF_ONE_HOP:
                    connection.putheader(name, value)
            connection.endheaders(body)
            answer = connection.getresponse()
            forwarded = {
                name.lower(): value for name, value in answer.headers.items() if name.lower() not in _OF_ONE_HOP
            }
            return answer.status, forwarded, answer.read()
        finally:
            connection.close()


def _answer(
    request: BaseHTTPRequestHandler, status: int, headers: Mapping[str, str], body: bytes, *, cut: bool = False
) -> None:
    length = headers.get("content-length", "0") if request.command == "HEAD" else str(len(body))
    request.send_response_only(status)
    for name, value in {**headers, "content-length": length}.items():
        request.send_header(name, value)
    request.end_headers()
    if request.command != "HEAD":
        request.wfile.write(body[: len(body) // 2] if cut else body)


@contextmanager
def standing_before(store: str) -> Iterator[Middleman]:
    """Stand before a store, given its address, on a free port of this machine."""

    class Handler(QuietHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            middleman.pass_on(self)

        def do_HEAD(self) -> None:
            middleman.pass_on(self)

        def do_PUT(self) -> None:
            middleman.pass_on(self)

        def do_POST(self) -> None:
            middleman.pass_on(self)

        def do_DELETE(self) -> None:
            middleman.pass_on(self)

    with serving(Handler) as port:
        middleman = Middleman(f"http://127.0.0.1:{port}", store)
        yield middleman
