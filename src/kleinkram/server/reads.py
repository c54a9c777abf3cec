"""Reads, which change nothing: once more where the database went away meanwhile, and only while somebody waits.

ASGI middleware for GET and HEAD of the API, but for signing in, where a GET may use up a code. A change is neither
repeated, since it may have been made, nor broken off half-way.
"""

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

_READS = frozenset({"GET", "HEAD"})
_API, _DOORS = "/api/v1/", "/api/v1/auth/"
# What the log says of a request whose sender left before there was an answer; no such answer is ever sent.
GONE = 499
# A database on the same machine that was killed is back after a third of a second.
_AGAIN_AFTER_S = 0.5
# Most reads are over by then, and cost no more than a timer.
_LOOKS_AFTER_S = 0.25


def may_be_read_again(scope: Scope) -> None:
    """Note that what a request found was a database that went away."""
    scope["state"]["was_cut_off"] = True


class Reads:
    """Passes requests on to `app`."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if not _is_read(scope):
            await self._app(scope, receive, send)
            return
        waiting = _Waiting(receive)
        answer = _FirstAnswer(scope, send, waiting)
        try:
            await self._app(scope, receive, answer.send)
            if answer.was_dropped:
                await asyncio.sleep(_AGAIN_AFTER_S)
                await self._app(scope, receive, waiting.until_told(send))
        except asyncio.CancelledError:
            if not waiting.is_over:
                raise
            scope["state"]["is_gone"] = True
        finally:
            waiting.end()


def _is_read(scope: Scope) -> bool:
    if scope["type"] != "http" or scope["method"] not in _READS:
        return False
    path: str = scope["path"]
    return path.startswith(_API) and not path.startswith(_DOORS)


class _Waiting:
    """Looks whether the asker still waits, and ends the task that works for them when they do not."""

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._task = asyncio.current_task()
        self._looking: asyncio.Task[None] | None = None
        self._timer = asyncio.get_running_loop().call_later(_LOOKS_AFTER_S, self._begin)
        self.is_over = False

    def until_told(self, send: Send) -> Send:
        """Return what sends, and stops looking once an answer begins: from there on, sending it finds out."""

        async def tell(message: Message) -> None:
            self.end()
            await send(message)

        return tell

    def end(self) -> None:
        """Look no more."""
        self._timer.cancel()
        if self._looking is not None:
            self._looking.cancel()

    def _begin(self) -> None:
        self._looking = asyncio.create_task(self._look())

    async def _look(self) -> None:
        while (await self._receive())["type"] != "http.disconnect":
            pass
        self.is_over = True
        if self._task is not None:
            self._task.cancel()


class _FirstAnswer:
    """Passes an answer on, unless it only says that the database went away."""

    def __init__(self, scope: Scope, send: Send, waiting: _Waiting) -> None:
        self._scope = scope
        self._send = waiting.until_told(send)
        self.was_dropped = False

    async def send(self, message: Message) -> None:
        """Pass on one message of it."""
        if message["type"] == "http.response.start":
            self.was_dropped = self._scope["state"].pop("was_cut_off", False)
        if not self.was_dropped:
            await self._send(message)
