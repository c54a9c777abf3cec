"""The web server: ends its streams before it waits for requests to end, and bounds what comes before a request.

What is in a request is bounded where it is read (`http`); its head is read by the server before anybody is asked.
"""

import asyncio
import socket

import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

_MOST_HEAD_BYTES = 64 * 1024
_HEAD_WITHIN_S = 30.0
_NOT_STARTED = "lifespan.startup.failed"
_TOO_LARGE = b"HTTP/1.1 431 Request Header Fields Too Large\r\ncontent-length: 0\r\nconnection: close\r\n\r\n"


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
        config.http = BoundedHeads
        config.app = _ShortFailure(app)
        super().__init__(config)
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams, wait for other requests, then stop."""
        hub = getattr(self._app.state, "hub", None)
        if hub is not None:
            hub.end()
        await super().shutdown(sockets)


class BoundedHeads(HttpToolsProtocol):
    """HTTP/1.1 whose heads (request line and headers) are bounded in size and time: who sends more is cut off."""

    _timer: asyncio.TimerHandle | None = None
    _is_in_head = False
    _head_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Give the first request its time."""
        super().connection_made(transport)
        self._wait_for_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the time."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read on, unless too much came of a head that has no end."""
        super().data_received(data)
        if not self._is_in_head or self.transport.is_closing():
            return
        self._head_bytes += len(data)
        if self._head_bytes > _MOST_HEAD_BYTES:
            self.transport.write(_TOO_LARGE)
            self.transport.close()

    def on_message_begin(self) -> None:
        """Begin a head."""
        super().on_message_begin()
        self._is_in_head, self._head_bytes = True, 0
        self._wait_for_head()

    def on_headers_complete(self) -> None:
        """End a head."""
        self._is_in_head = False
        self._stop_waiting()
        super().on_headers_complete()

    def _wait_for_head(self) -> None:
        self._stop_waiting()
        self._timer = self.loop.call_later(_HEAD_WITHIN_S, self.transport.close)

    def _stop_waiting(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
