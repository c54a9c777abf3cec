"""The web server: ends its streams before it waits for requests to end, and bounds what a connection may cost.

Bounded are the size and time of heads, the pace of bodies, what surrounds the bytes of a body (chunk extensions,
trailers), and the number of connections, of one address and in all. Bodies are bounded in size where they are read
(`http`).
"""

import asyncio
import ipaddress
import logging
import resource
import socket
import sys
import time
from collections import defaultdict
from collections.abc import Iterable

import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from kleinkram.server.proxies import Network, parse_address
from kleinkram.server.settings import Settings

_log = logging.getLogger("kleinkram.serving")
_MOST_HEAD_BYTES = 64 * 1024
_HEAD_WITHIN_S = 30.0
# A body must arrive within a time that grows with what has arrived, as Apache's RequestReadTimeout has it.
_BODY_WITHIN_S = 30.0
_BODY_BYTES_PER_S = 4096
# What surrounds the bytes of a body: a chunk of one byte takes five more, a chunk extension may say a little.
_FRAMING_BYTES = 64 * 1024
_FRAMING_PER_BODY_BYTE = 16
# A client that was answered before it had sent all may read the answer before the connection is closed.
_LINGER_S = 10.0
_MOST_CONNECTIONS = 16_384
# Files that this process opens for other purposes: database, store, logs.
_OTHER_FILES = 256
_IPV6_PREFIX = 64
_NO_ROOM = 503
_REFUSALS = {
    408: b"HTTP/1.1 408 Request Timeout\r\ncontent-length: 0\r\nconnection: close\r\n\r\n",
    413: b"HTTP/1.1 413 Content Too Large\r\ncontent-length: 0\r\nconnection: close\r\n\r\n",
    431: b"HTTP/1.1 431 Request Header Fields Too Large\r\ncontent-length: 0\r\nconnection: close\r\n\r\n",
    _NO_ROOM: b"HTTP/1.1 503 Service Unavailable\r\nretry-after: 5\r\ncontent-length: 0\r\nconnection: close\r\n\r\n",
}
_NOT_STARTED = "lifespan.startup.failed"


class _ShortFailure:
    """An app of whose failure to start the last line is told, a sentence, in place of a traceback."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on everything else."""

        async def send_short(message: Message) -> None:
            if message["type"] == _NOT_STARTED:
                message["message"] = _sentence(message["message"])
            await send(message)

        await self._app(scope, receive, send_short if scope["type"] == "lifespan" else send)


def _sentence(traceback: str) -> str:
    """Return the sentence at a traceback's end where it is one of ours, else all of it: a fault to be looked into."""
    kind, _, sentence = traceback.strip().splitlines()[-1].partition(": ")
    return f"not started: {sentence}" if kind.startswith("kleinkram.") else traceback


class ApiServer(uvicorn.Server):
    """Serves one app."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        settings: Settings = app.state.settings
        connections = OpenConnections(
            per_address=settings.connections_per_address,
            in_all=min(_MOST_CONNECTIONS, max(1, raise_open_files_limit() - _OTHER_FILES)),
            unlimited=settings.trusted_proxies,
        )
        config.http = type("LimitedHttp", (LimitedHttp,), {"open_connections": connections})
        config.app = _ShortFailure(app)
        super().__init__(config)
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams, wait for other requests, then stop."""
        hub = getattr(self._app.state, "hub", None)
        if hub is not None:
            hub.end()
        await super().shutdown(sockets)


def raise_open_files_limit() -> int:
    """Raise the soft limit of open files of this process to the hard one; return what it is now."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if resource.RLIM_INFINITY in (soft, hard):
        return sys.maxsize
    if soft == hard:
        return soft
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    except (ValueError, OSError) as error:
        _log.warning("open files limit not raised", extra={"fields": {"limit": soft, "reason": str(error)}})
        return soft
    return hard


class OpenConnections:
    """The connections of a process, by the address of their peer; an IPv6 peer counts as its /64 network.

    Where an address has as many as it may have, the oldest one that waits for a request to arrive gives way to a new
    one: a client that opens many without asking anything shuts nobody out, not even others behind its own address.
    """

    def __init__(self, *, per_address: int, in_all: int, unlimited: Iterable[Network] = ()) -> None:
        self._per_address = per_address
        self._in_all = in_all
        self._unlimited = tuple(unlimited)
        self._of_address: dict[str, dict[LimitedHttp, None]] = defaultdict(dict)
        self._all: dict[LimitedHttp, None] = {}

    def add(self, connection: "LimitedHttp", peer: str) -> bool:
        """Count a new connection; False where there is no room for it and none to be made."""
        address = self._limited_address(peer)
        siblings = self._of_address[address] if address is not None else {}
        if address is not None and len(siblings) >= self._per_address and not _close_idle(siblings):
            return False
        if len(self._all) >= self._in_all and not _close_idle(self._all):
            return False
        self._all[connection] = None
        if address is not None:
            self._of_address[address][connection] = None
        return True

    def remove(self, connection: "LimitedHttp", peer: str) -> None:
        """Count a connection no longer."""
        self._all.pop(connection, None)
        address = self._limited_address(peer)
        if address is not None and (siblings := self._of_address.get(address)) is not None:
            siblings.pop(connection, None)
            if not siblings:
                del self._of_address[address]

    def _limited_address(self, peer: str) -> str | None:
        """Return the address under which a peer is counted; None where it may have any number."""
        address = parse_address(peer)
        if address is None:
            return peer
        if any(address in network for network in self._unlimited):
            return None
        if isinstance(address, ipaddress.IPv6Address):
            return str(ipaddress.ip_network((address, _IPV6_PREFIX), strict=False))
        return str(address)


def _close_idle(connections: "dict[LimitedHttp, None]") -> bool:
    """Close the oldest connection whose request has not arrived yet; False where there is none."""
    oldest = next((each for each in connections if each.is_receiving), None)
    if oldest is None:
        return False
    del connections[oldest]
    oldest.refuse(408)
    return True


class LimitedHttp(HttpToolsProtocol):
    """HTTP/1.1 that closes a connection which sends too much around a body, too slowly, or is one too many."""

    open_connections: OpenConnections
    cycle: RequestResponseCycle | None  # type: ignore[assignment]  # uvicorn begins with None, and does not say so
    _timer: asyncio.TimerHandle | None = None
    _is_in_head = False
    _is_in_body = False
    _head_bytes = 0
    _body_bytes = 0
    # Of the message that is arriving: all bytes after its head, and those since the parser last passed a part of it.
    _sent_bytes = 0
    _unparsed_bytes = 0
    _body_began_at = 0.0

    @property
    def is_receiving(self) -> bool:
        """Whether the connection waits for a request to arrive as a whole, and answers none."""
        if self.pipeline:
            return False
        return self._is_in_body or self.cycle is None or bool(self.cycle.response_complete)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Give the first request its time."""
        super().connection_made(transport)
        if not self.open_connections.add(self, self._peer):
            self.refuse(_NO_ROOM)
            return
        self._wait_for_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._stop_waiting()
        self.open_connections.remove(self, self._peer)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read on, unless too much came of a head, or around a body, that has no end."""
        if self.transport.is_closing():
            return
        self._sent_bytes += len(data)
        self._unparsed_bytes += len(data)
        super().data_received(data)
        if self.transport.is_closing():
            return
        if self._is_in_head:
            self._head_bytes += len(data)
            if self._head_bytes > _MOST_HEAD_BYTES:
                self.refuse(431)
        elif self._is_in_body:
            framing = self._sent_bytes - self._body_bytes
            if self._unparsed_bytes > _FRAMING_BYTES or framing > (
                _FRAMING_BYTES + _FRAMING_PER_BODY_BYTE * self._body_bytes
            ):
                self.refuse(413)
        elif self._timer is None and self.is_receiving:
            self._wait_for_head()  # empty lines before a request end uvicorn's own time for an idle connection

    def on_message_begin(self) -> None:
        """Begin a head."""
        super().on_message_begin()
        self._is_in_head, self._head_bytes = True, 0
        self._wait_for_head()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take headers, and drop trailers: they come after the request was passed on, and nothing here reads them."""
        if self._is_in_head:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """End a head, and begin a body."""
        self._is_in_head, self._is_in_body = False, True
        self._sent_bytes = self._body_bytes = self._unparsed_bytes = 0
        self._body_began_at = time.monotonic()
        self._wait_for_body()
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Count the bytes of a body."""
        self._body_bytes += len(body)
        self._unparsed_bytes = 0
        super().on_body(body)

    def on_chunk_header(self) -> None:
        """Note that the head of a chunk ended."""
        self._unparsed_bytes = 0

    def on_message_complete(self) -> None:
        """End a body."""
        self._is_in_body = False
        self._stop_waiting()
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Where a request was answered before all of it had arrived, wait only a little for the rest."""
        super().on_response_complete()
        if self._is_in_body and not self.transport.is_closing():
            self._stop_waiting()
            self._timer = self.loop.call_later(_LINGER_S, self.transport.close)

    def refuse(self, status: int) -> None:
        """Close the connection, and say why where a request has begun and its answer has not."""
        self._stop_waiting()
        if self.transport.is_closing():
            return
        is_answering = self.cycle is not None and self.cycle.response_started and not self.cycle.response_complete
        if (self._is_in_head or self._is_in_body or status == _NO_ROOM) and not is_answering:
            self.transport.write(_REFUSALS[status])
        self.transport.close()

    @property
    def _peer(self) -> str:
        return self.client[0] if self.client else ""

    def _wait_for_head(self) -> None:
        self._stop_waiting()
        self._timer = self.loop.call_later(_HEAD_WITHIN_S, self.transport.close)

    def _wait_for_body(self) -> None:
        self._stop_waiting()
        self._timer = self.loop.call_later(_BODY_WITHIN_S, self._check_body)

    def _check_body(self) -> None:
        """Close a connection whose body comes too slowly; its time does not pass while we do not read."""
        if self.flow.read_paused:
            self._body_began_at = time.monotonic()
        due_at = self._body_began_at + _BODY_WITHIN_S + self._body_bytes / _BODY_BYTES_PER_S
        left_s = due_at - time.monotonic()
        if left_s <= 0:
            self.refuse(408)
            return
        self._timer = self.loop.call_later(left_s, self._check_body)

    def _stop_waiting(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
