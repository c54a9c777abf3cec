"""Request middleware: request ids, client addresses, body limits, security headers, access log and request metrics."""

import asyncio
import logging
import re
import time
import uuid

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kleinkram.contract.errors import BodyTooLarge, WrongClient
from kleinkram.contract.reports import MAX_REPORT_BODY_BYTES
from kleinkram.json_logs import log_fields
from kleinkram.server import metrics
from kleinkram.server.access.actor import Actor
from kleinkram.server.http.errors import problem_response
from kleinkram.server.http.headers import set_client_address, with_security_headers
from kleinkram.server.settings import Settings

_log = logging.getLogger("kleinkram.http")
_MAX_ID_CHARACTERS = 36
# Anonymous requests do little but sign in, which takes little. Credentials are not checked yet at this point.
_ANONYMOUS_BODY_BYTES = 64 * 1024
_API_PATH, _SIGN_IN_PATH = "/api/v1/", "/api/v1/auth/"
# Requests that send a report, which is refused whole or stored whole.
_REPORT_PATH = re.compile(r"/api/v1/(runner/runs/[^/]+/finish|runs/recorded|missions/[^/]+/check-reports)")
# Sent by the Python client of the original Kleinkram with each request.
_ORIGINAL_CLIENT_HEADER = b"kleinkram-client-version"
_REQUEST_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")
# Logged when the client disconnected before the response; never sent.
_CLIENT_CLOSED_REQUEST = 499
# Most reads end earlier and cost only a timer.
_DISCONNECT_CHECK_AFTER_S = 0.25


def mark_as_stream(scope: Scope) -> None:
    """Exclude a response that streams, or waits for something to happen, from the request durations."""
    scope["state"]["is_stream"] = True


class RequestMiddleware:
    """ASGI middleware around every request."""

    def __init__(self, app: ASGIApp, *, settings: Settings) -> None:
        self._app = CancelAbandonedReads(app)
        self._body_limit_bytes = settings.body_limit_bytes
        self._trusted_proxies = settings.trusted_proxies
        self._public_url = settings.public_url
        self._is_https = settings.public_url.startswith("https://")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        client_request_id = headers.get(b"x-request-id", b"")
        is_valid_id = _REQUEST_ID.fullmatch(client_request_id)
        request_id = client_request_id.decode() if is_valid_id else uuid.uuid4().hex
        scope.setdefault("state", {})["request_id"] = request_id
        scope["state"]["peer"] = scope["client"][0] if scope.get("client") else ""
        set_client_address(scope, self._trusted_proxies)
        started = time.perf_counter()
        status = 500

        async def send_with_headers(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                own_headers = [*message["headers"], (b"x-request-id", request_id.encode())]
                if scope["app"].state.is_draining:
                    own_headers.append((b"connection", b"close"))
                message["headers"] = with_security_headers(own_headers, is_https=self._is_https)
            await send(message)

        with log_fields(request_id=request_id):
            try:
                await self._limit_body(scope, receive, send_with_headers, headers)
            finally:
                status = _CLIENT_CLOSED_REQUEST if scope["state"].get("is_abandoned") else status
                _log_request(scope, status, time.perf_counter() - started)

    async def _limit_body(self, scope: Scope, receive: Receive, send: Send, headers: dict[bytes, bytes]) -> None:
        request_id = scope["state"]["request_id"]
        if _ORIGINAL_CLIENT_HEADER in headers:
            await problem_response(WrongClient(server=self._public_url), request_id)(scope, receive, send)
            return
        limit = self._body_limit_bytes
        if scope["method"] == "POST" and _REPORT_PATH.fullmatch(scope["path"]):
            limit = max(limit, MAX_REPORT_BODY_BYTES)
        is_anonymous = b"authorization" not in headers and b"cookie" not in headers
        if is_anonymous or scope["path"].startswith(_SIGN_IN_PATH):
            limit = min(limit, _ANONYMOUS_BODY_BYTES)
        declared = headers.get(b"content-length", b"0")
        if declared.isdigit() and int(declared) > limit:
            too_large = BodyTooLarge(size_bytes=int(declared), limit_bytes=limit)
            await problem_response(too_large, request_id)(scope, receive, send)
            return
        received = 0

        async def receive_limited() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > limit:  # the framework's body parser lets only HTTPException pass
                raise HTTPException(413, detail=f"{received} {limit}")
            return message

        await self._app(scope, receive_limited, send)


class CancelAbandonedReads:
    """ASGI middleware: cancels a read, and so its query, when the client disconnects before the response.

    Applies to GET and HEAD of the API except for signing in, where a GET may use up a code. Changes are completed.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        path = scope.get("path", "")
        is_read = scope["type"] == "http" and scope["method"] in {"GET", "HEAD"}
        if not is_read or not path.startswith(_API_PATH) or path.startswith(_SIGN_IN_PATH):
            await self._app(scope, receive, send)
            return
        request_task, watcher = asyncio.current_task(), None
        disconnected = False

        async def watch() -> None:
            nonlocal disconnected
            while (await receive())["type"] != "http.disconnect":
                pass
            disconnected = True
            if request_task is not None:
                request_task.cancel()

        def start_watching() -> None:
            nonlocal watcher
            watcher = asyncio.create_task(watch())

        def stop_watching() -> None:
            timer.cancel()
            if watcher is not None:
                watcher.cancel()

        async def send_and_stop_watching(message: Message) -> None:
            stop_watching()  # from here on, sending notices a disconnect
            await send(message)

        timer = asyncio.get_running_loop().call_later(_DISCONNECT_CHECK_AFTER_S, start_watching)
        try:
            await self._app(scope, receive, send_and_stop_watching)
        except asyncio.CancelledError:
            if not disconnected:
                raise
            scope["state"]["is_abandoned"] = True
        finally:
            stop_watching()


def _log_request(scope: Scope, status: int, seconds: float) -> None:
    path = route_of(scope)
    metrics.REQUESTS.labels(scope["method"], path, str(status)).inc()
    if "is_stream" not in scope["state"]:
        metrics.REQUEST_SECONDS.labels(scope["method"], path).observe(seconds)
    if path.startswith("/health") and status < 500:
        return
    fields = {
        "method": scope["method"],
        "route": path,
        "path": printed_path(scope),
        "status": status,
        "duration_ms": round(seconds * 1000, 1),
        **actor_fields(scope),
    }
    _log.info("request", extra={"fields": fields})


def route_of(scope: Scope) -> str:
    """Return the template of a request's path: of few values, unlike the path."""
    path: str = getattr(scope.get("route"), "path", "unmatched")
    return path


def printed_path(scope: Scope) -> str:
    """Return a request's path for logs and traces."""
    # Parts that are longer than any id may be tokens, pasted by mistake.
    parts = (part if len(part) <= _MAX_ID_CHARACTERS else f"{part[:8]}…" for part in scope["path"].split("/"))
    return "/".join(parts)


def actor_fields(scope: Scope) -> dict[str, str]:
    """Return the ids of who sent a request: of the person, and of the token or the link."""
    actor: Actor | None = scope["state"].get("actor")
    if actor is None:
        return {}
    ids = {"person_id": actor.person_id, "token_id": actor.token_id, "share_id": actor.share_id}
    return {name: str(value) for name, value in ids.items() if value is not None}
