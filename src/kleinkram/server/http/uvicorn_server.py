"""uvicorn with limits on what one connection may cost.

Limits the size and duration of request heads, the pace of bodies, chunk extensions and trailers, and the number of
connections per address and in total. `middleware` limits the size of bodies. A process that stops behind proxies lets
them leave first; then streams end, then other requests. systemd learns when the server is ready and that its event loop
runs.
"""

import asyncio
import logging
import os
import resource
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress

import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from kleinkram.server.http.headers import parse_address
from kleinkram.server.http.rate_limit import subscriber_network
from kleinkram.server.settings import Network, Settings
from kleinkram.systemd import Watchdog, notify_ready, notify_stopping

_log = logging.getLogger("kleinkram.web_server")
_MAX_HEAD_BYTES = 64 * 1024
_HEAD_TIMEOUT_S = 30.0
# The timeout of a body grows with the bytes received, like Apache's RequestReadTimeout.
_BODY_TIMEOUT_S = 30.0
_BODY_BYTES_PER_S = 4096
# Allowed framing of a chunked body: a chunk of one byte takes five more bytes, and extensions may be short.
_FRAMING_BYTES = 64 * 1024
_FRAMING_PER_BODY_BYTE = 16
# A client that got a response before it sent the whole request has this time to read it.
_LINGER_S = 10.0
_DRAIN_CHECK_S = 0.1
# A proxy that has connected sends its request within this time.
_LAST_REQUEST_S = 1.0
_MAX_CONNECTIONS = 16_384
# Files that this process opens for the database, the store and logs.
_OTHER_FILES = 256
_TOO_MANY_CONNECTIONS = 503
_CLOSE = b"content-length: 0\r\nconnection: close\r\n\r\n"
_REFUSED_RESPONSES = {
    408: b"HTTP/1.1 408 Request Timeout\r\n" + _CLOSE,
    413: b"HTTP/1.1 413 Content Too Large\r\n" + _CLOSE,
    431: b"HTTP/1.1 431 Request Header Fields Too Large\r\n" + _CLOSE,
    _TOO_MANY_CONNECTIONS: b"HTTP/1.1 503 Service Unavailable\r\nretry-after: 5\r\n" + _CLOSE,
}


def _with_short_startup_errors(app: ASGIApp) -> ASGIApp:
    """Return an app that reports one of our own errors at startup as a sentence instead of a traceback."""

    async def call(scope: Scope, receive: Receive, send: Send) -> None:
        async def send_short(message: Message) -> None:
            if message["type"] == "lifespan.startup.failed":
                kind, _, sentence = message["message"].strip().splitlines()[-1].partition(": ")
                if kind.startswith("kleinkram."):
                    message["message"] = f"not started: {sentence}"
            await send(message)

        await app(scope, receive, send_short if scope["type"] == "lifespan" else send)

    return call


class ApiServer(uvicorn.Server):
    """uvicorn with these limits, for one app."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        settings: Settings = app.state.settings
        connections = OpenConnections(
            per_address=settings.connections_per_address,
            total=min(_MAX_CONNECTIONS, max(1, raise_open_files_limit() - _OTHER_FILES)),
            unlimited=settings.trusted_proxies,
        )
        config.http = type("LimitedHttp", (LimitedHttp,), {"open_connections": connections})
        config.app = _with_short_startup_errors(app)
        super().__init__(config)
        self._app = app
        self._drain_s = settings.drain_s if settings.trusted_proxies else 0.0

    async def main_loop(self) -> None:
        """Serve until a signal; tell systemd that this process is ready, and as long as its event loop runs."""
        notify_ready(f"serving on port {self.config.port}")
        pings = asyncio.create_task(Watchdog().ping_from_event_loop())
        await super().main_loop()
        notify_stopping()
        await self._drain()
        pings.cancel()

    async def _drain(self) -> None:
        """Serve on until no proxy has an idle connection to this process; a second SIGINT ends it.

        `/health/ready` is 503, and each response closes its connection. A proxy that sends a request on a connection
        that this process closes meanwhile may not repeat it, and answers 502.
        """
        self._app.state.is_draining = True
        if self._drain_s:
            await self._wait(self._drain_s)
            await self._stop_listening()
            await self._wait(_LAST_REQUEST_S)

    async def _wait(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not self.force_exit:  # noqa: ASYNC110  (a signal handler sets it)
            await asyncio.sleep(_DRAIN_CHECK_S)

    async def _stop_listening(self) -> None:
        """Refuse new connections, but serve those that wait to be accepted: closing the socket alone resets them."""
        waiting = []
        for server in self.servers:
            for listener in server.sockets:
                with socket.socket(fileno=os.dup(listener.fileno())) as own, suppress(OSError):
                    own.setblocking(False)
                    while True:
                        waiting.append(own.accept()[0])
            server.close()
        loop, tls = asyncio.get_running_loop(), self.config.ssl
        accepted = (loop.connect_accepted_socket(self._protocol, connection, ssl=tls) for connection in waiting)
        # A client that breaks off the handshake of TLS, or never begins it, does not keep this process from stopping.
        attempts = (asyncio.wait_for(attempt, _LAST_REQUEST_S) for attempt in accepted)
        await asyncio.gather(*attempts, return_exceptions=True)

    def _protocol(self) -> asyncio.Protocol:
        return self.config.http_protocol_class(  # type: ignore[call-arg]  # uvicorn declares it as any protocol
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End event streams, wait for other requests, then stop."""
        hub = getattr(self._app.state, "hub", None)
        if hub is not None:
            hub.close()
        await super().shutdown(sockets)


def raise_open_files_limit() -> int:
    """Raise this process's soft limit of open files to the hard limit; return the new limit."""
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
    """The connections of a process by peer address; an IPv6 peer counts as its /64 network.

    At the limit, a new connection replaces the oldest one that waits for a request: a client that opens idle
    connections does not lock out others, even behind its own address.
    """

    def __init__(self, *, per_address: int, total: int, unlimited: Iterable[Network] = ()) -> None:
        self._per_address = per_address
        self._total = total
        self._unlimited = tuple(unlimited)
        # In the order of their arrival, with the address under which each is counted.
        self._addresses: dict[LimitedHttp, str | None] = {}
        self._counts: Counter[str] = Counter()

    def add(self, connection: "LimitedHttp", peer: str) -> bool:
        """Register a connection; False if the limit is reached and no connection is idle."""
        address = self._limited_address(peer)
        if address is not None and self._counts[address] >= self._per_address and not self._close_idle(address):
            return False
        if len(self._addresses) >= self._total and not self._close_idle():
            return False
        self._addresses[connection] = address
        if address is not None:
            self._counts[address] += 1
        return True

    def remove(self, connection: "LimitedHttp") -> None:
        """Unregister a connection."""
        address = self._addresses.pop(connection, None)
        if address is not None:
            self._counts[address] -= 1
            if not self._counts[address]:
                del self._counts[address]

    def _close_idle(self, address: str | None = None) -> bool:
        """Close the oldest connection (of an address) whose request has not arrived yet; False if there is none."""
        for connection, counted_as in self._addresses.items():
            if connection.is_receiving and address in (None, counted_as):
                self.remove(connection)
                connection.refuse(408)
                return True
        return False

    def _limited_address(self, peer: str) -> str | None:
        """Return the address under which a peer is counted; None if the peer is unlimited."""
        address = parse_address(peer)
        if address is None:
            return peer
        if any(address in network for network in self._unlimited):
            return None
        return subscriber_network(str(address))


class LimitedHttp(HttpToolsProtocol):
    """HTTP/1.1 that closes connections which exceed a limit."""

    open_connections: OpenConnections
    cycle: RequestResponseCycle | None  # type: ignore[assignment]  # None at first, which uvicorn does not declare
    _timer: asyncio.TimerHandle | None = None
    _is_in_head = False
    _is_in_body = False
    _head_bytes = 0
    _body_bytes = 0
    # Of the current message: all bytes after its head, and those since the parser last delivered part of the body.
    _message_bytes = 0
    _unparsed_bytes = 0
    _body_started_at = 0.0

    @property
    def is_receiving(self) -> bool:
        """Whether the connection waits for the rest of a request and sends no response."""
        if self.pipeline:
            return False
        return self._is_in_body or self.cycle is None or bool(self.cycle.response_complete)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # uvicorn's signature
        """Register the connection and start the timeout of the first request."""
        super().connection_made(transport)
        if not self.open_connections.add(self, self.client[0] if self.client else ""):
            self.refuse(_TOO_MANY_CONNECTIONS)
            return
        self._start_head_timeout()

    def connection_lost(self, exc: Exception | None) -> None:
        """Unregister the connection."""
        self._cancel_timer()
        self.open_connections.remove(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Parse data unless the head or the framing of the body is too large."""
        if self.transport.is_closing():
            return
        self._message_bytes += len(data)
        self._unparsed_bytes += len(data)
        super().data_received(data)
        if self.transport.is_closing():
            return
        if self._is_in_head:
            self._head_bytes += len(data)
            if self._head_bytes > _MAX_HEAD_BYTES:
                self.refuse(431)
        elif self._is_in_body:
            framing = self._message_bytes - self._body_bytes
            if self._unparsed_bytes > _FRAMING_BYTES or framing > (
                _FRAMING_BYTES + _FRAMING_PER_BODY_BYTE * self._body_bytes
            ):
                self.refuse(413)
        elif self._timer is None and self.is_receiving:
            self._start_head_timeout()  # empty lines before a request end uvicorn's keep-alive timeout

    def on_message_begin(self) -> None:
        """Start the head of a message."""
        super().on_message_begin()
        self._is_in_head, self._head_bytes = True, 0
        self._start_head_timeout()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Pass headers on and drop trailers, which arrive after the request was dispatched."""
        if self._is_in_head:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """End the head and start the body."""
        self._is_in_head, self._is_in_body = False, True
        self._message_bytes = self._body_bytes = self._unparsed_bytes = 0
        self._body_started_at = time.monotonic()
        self._set_timer(_BODY_TIMEOUT_S, self._check_body)
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Count the bytes of the body."""
        self._body_bytes += len(body)
        self._unparsed_bytes = 0
        super().on_body(body)

    def on_chunk_header(self) -> None:
        """Count framing from the end of a chunk's header."""
        self._unparsed_bytes = 0

    def on_message_complete(self) -> None:
        """End the message."""
        self._is_in_body = False
        self._cancel_timer()
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """If the request has not arrived entirely, close the connection soon."""
        super().on_response_complete()
        if self._is_in_body and not self.transport.is_closing():
            self._set_timer(_LINGER_S, self.transport.close)

    def refuse(self, status: int) -> None:
        """Close the connection, with an error response if a request has begun and its response has not."""
        self._cancel_timer()
        if self.transport.is_closing():
            return
        is_answering = self.cycle is not None and self.cycle.response_started and not self.cycle.response_complete
        if (self._is_in_head or self._is_in_body or status == _TOO_MANY_CONNECTIONS) and not is_answering:
            self.transport.write(_REFUSED_RESPONSES[status])
        self.transport.close()

    def _start_head_timeout(self) -> None:
        self._set_timer(_HEAD_TIMEOUT_S, self.transport.close)

    def _check_body(self) -> None:
        """Close the connection if its body arrives too slowly; paused reading does not count."""
        if self.flow.read_paused:
            self._body_started_at = time.monotonic()
        due_at = self._body_started_at + _BODY_TIMEOUT_S + self._body_bytes / _BODY_BYTES_PER_S
        remaining_s = due_at - time.monotonic()
        if remaining_s <= 0:
            self.refuse(408)
        else:
            self._set_timer(remaining_s, self._check_body)

    def _set_timer(self, delay_s: float, action: Callable[[], None]) -> None:
        self._cancel_timer()
        self._timer = self.loop.call_later(delay_s, action)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
