"""What every answer has in common: a request id, a bounded body, guarding headers, failures as problem documents."""

import json
import logging
import re
import time
import uuid

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kleinkram.contract.errors import (
    BodyTooLarge,
    DatabaseUnavailable,
    FieldProblem,
    InternalError,
    InvalidRequest,
    KleinkramError,
    MethodNotAllowed,
    NotFound,
    RateLimited,
    WrongClient,
)
from kleinkram.contract.problems import to_problem
from kleinkram.contract.wording import message_of
from kleinkram.server import metrics
from kleinkram.server.audit.places import named
from kleinkram.server.audit.refusals import ALSO_REFUSALS, Refusal, Refusals
from kleinkram.server.db import was_cut_off
from kleinkram.server.headers import guarded
from kleinkram.server.proxies import set_asker
from kleinkram.server.reads import GONE, Reads, may_be_read_again
from kleinkram.server.settings import Settings
from kleinkram.server.turns import note_arrival
from kleinkram.server.web.serving import app_page, is_of_original, wants_page

_log = logging.getLogger("kleinkram.http")
_LONGEST_ID = 36
# Strangers can do little but sign in, which takes little; there, whatever comes with them proves nothing yet.
_STRANGERS_BODY_BYTES = 64 * 1024
_DOORS = "/api/v1/auth/"
# What is said of one invalid request: to tell all that is wrong with a large one would keep everybody else waiting.
_MOST_PROBLEMS = 100
_MOST_CHARACTERS = 1000
# What the original's Python client says of itself in each request.
_ORIGINALS_HEADER = b"kleinkram-client-version"
_REQUEST_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")


def mark_as_stream(scope: Scope) -> None:
    """Note that an answer lasts for as long as somebody listens: its time says nothing of how fast we are."""
    scope["state"]["is_stream"] = True


class Envelope:
    """ASGI middleware: names each request and where it is from, bounds its body, guards, logs and counts its answer."""

    def __init__(self, app: ASGIApp, *, settings: Settings) -> None:
        self._app = Reads(app)
        self._body_limit_bytes = settings.body_limit_bytes
        self._trusted = settings.trusted_proxies
        self._public_url = settings.public_url
        self._is_https = settings.public_url.startswith("https://")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        given = headers.get(b"x-request-id", b"")
        request_id = given.decode() if _REQUEST_ID.fullmatch(given) else uuid.uuid4().hex
        scope.setdefault("state", {})["request_id"] = request_id
        scope["state"]["peer"] = scope["client"][0] if scope.get("client") else ""
        set_asker(scope, scope["headers"], self._trusted)
        note_arrival()
        started = time.perf_counter()
        status = 500

        async def send_named(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                named = [*message["headers"], (b"x-request-id", request_id.encode())]
                message["headers"] = guarded(named, is_https=self._is_https)
            await send(message)

        try:
            await self._bounded(scope, receive, send_named, headers)
        finally:
            status = GONE if scope["state"].get("is_gone") else status
            self._account(scope, status, time.perf_counter() - started, request_id)

    async def _bounded(self, scope: Scope, receive: Receive, send: Send, headers: dict[bytes, bytes]) -> None:
        if _ORIGINALS_HEADER in headers:
            error = WrongClient(server=self._public_url)
            await problem_response(error, scope["state"]["request_id"])(scope, receive, send)
            return
        limit = self._body_limit_bytes
        is_nobody = b"authorization" not in headers and b"cookie" not in headers
        if is_nobody or scope["path"].startswith(_DOORS):
            limit = min(limit, _STRANGERS_BODY_BYTES)
        request_id = scope["state"]["request_id"]
        declared = headers.get(b"content-length", b"0")
        if declared.isdigit() and int(declared) > limit:
            too_large = BodyTooLarge(size_bytes=int(declared), limit_bytes=limit)
            await problem_response(too_large, request_id)(scope, receive, send)
            return
        received = 0

        async def receive_bounded() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > limit:  # HTTPException is what passes through the framework's body parser
                raise HTTPException(413, detail=f"{received} {limit}")
            return message

        await self._app(scope, receive_bounded, send)

    @staticmethod
    def _account(scope: Scope, status: int, seconds: float, request_id: str) -> None:
        route = scope.get("route")
        path = getattr(route, "path", "unmatched")
        metrics.REQUESTS.labels(scope["method"], path, str(status)).inc()
        if "is_stream" not in scope["state"]:
            metrics.REQUEST_SECONDS.labels(scope["method"], path).observe(seconds)
        if path.startswith("/health") and status < 500:
            return
        shown = _shown(scope["path"])
        fields = {"method": scope["method"], "path": shown, "status": status, "request_id": request_id}
        _log.info("request", extra={"fields": {**fields, "duration_ms": round(seconds * 1000, 1)}})


def _shown(path: str) -> str:
    """Return a path for the log: a part that is longer than any id, such as a token put there by mistake, is cut."""
    return "/".join(part if len(part) <= _LONGEST_ID else f"{part[:8]}…" for part in path.split("/"))


def problem_response(error: KleinkramError, request_id: str | None) -> JSONResponse:
    """Return the answer that an error stands for."""
    problem = to_problem(error, request_id)
    headers = {"Retry-After": "2"} if error.status == 503 else {}
    if isinstance(error, RateLimited):
        headers["Retry-After"] = str(error.retry_after_s)
    if error.status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    return JSONResponse(
        json.loads(problem.model_dump_json(exclude_none=True)),
        status_code=error.status,
        media_type="application/problem+json",
        headers=headers,
    )


def _request_id(request: Request) -> str | None:
    return getattr(request.state, "request_id", None)


async def _on_failure(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, KleinkramError):
        raise error
    if error.status in {401, 403} or error.code in ALSO_REFUSALS:
        await note_refusal(request, error)
    if isinstance(error, DatabaseUnavailable) and was_cut_off(error):
        may_be_read_again(request.scope)
    return problem_response(error, _request_id(request))


async def note_refusal(request: Request, error: KleinkramError) -> None:
    """Put into the record that a request was refused."""
    state = request.app.state
    if not hasattr(state, "refusals"):
        state.refusals = Refusals()
    # The route's own path: what else stands in the address is the asker's, of any length and content.
    place = f"{request.method} {getattr(request.scope.get('route'), 'path', 'unmatched')}"
    refusal = Refusal(
        actor=getattr(request.state, "actor", None),
        code=error.code,
        place=place,
        why={name: str(value) for name, value in error.fields().items()},
        address=request.client.host if request.client else None,
        request_id=_request_id(request),
        about=named(request.path_params, request.query_params),
    )
    await state.refusals.note(state.database, refusal)


async def _on_invalid(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    problems = [
        FieldProblem(
            field=".".join(str(part)[:_MOST_CHARACTERS] for part in issue["loc"]),
            message=message_of(issue)[:_MOST_CHARACTERS],
        )
        for issue in error.errors()[:_MOST_PROBLEMS]
    ]
    return problem_response(InvalidRequest(problems=problems), _request_id(request))


async def _on_http_exception(request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException):
        raise error
    if error.status_code == 413:
        size_bytes, limit_bytes = map(int, error.detail.split())
        return problem_response(BodyTooLarge(size_bytes=size_bytes, limit_bytes=limit_bytes), _request_id(request))
    if error.status_code == 405:
        return problem_response(MethodNotAllowed(method=request.method, path=request.url.path), _request_id(request))
    settings: Settings = request.app.state.settings
    if error.status_code == 404 and wants_page(request) and not _is_sign_in_of_original(request):
        return app_page(settings, status=404)
    if error.status_code == 404 and is_of_original(request.url.path):
        return problem_response(WrongClient(server=settings.public_url), _request_id(request))
    if error.status_code == 404:
        return problem_response(NotFound(noun="page", ref=request.url.path), _request_id(request))
    problem = FieldProblem(field="request", message=str(error.detail))
    return problem_response(InvalidRequest(problems=[problem]), _request_id(request))


def _is_sign_in_of_original(request: Request) -> bool:
    """Say whether a browser was opened by the original's client, to sign in for it."""
    return request.url.path.startswith("/auth/") and request.query_params.get("state", "").startswith("cli")


async def _on_crash(request: Request, error: Exception) -> JSONResponse:
    request_id = _request_id(request) or "unknown"
    if isinstance(error, ConnectionError | TimeoutError):
        return problem_response(DatabaseUnavailable(), request_id)
    _log.error("crash", exc_info=error, extra={"fields": {"request_id": request_id}})
    return problem_response(InternalError(request_id=request_id), request_id)


def install_handlers(app: FastAPI) -> None:
    """Turn every failure of an app into a problem document."""
    app.add_exception_handler(KleinkramError, _on_failure)
    app.add_exception_handler(RequestValidationError, _on_invalid)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(Exception, _on_crash)
