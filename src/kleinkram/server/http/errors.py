"""Error responses: every failure becomes a problem document (RFC 9457), and denials go to the audit log."""

import json
import logging

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

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
from kleinkram.contract.problems import message_of, to_problem
from kleinkram.server.audit.queries import request_target
from kleinkram.server.audit.refusals import ALSO_REFUSALS, Refusal, Refusals
from kleinkram.server.http.pages import app_page, is_original_api_path, is_page_request
from kleinkram.server.settings import Settings

_log = logging.getLogger("kleinkram.http")
# Bounds of the description of one invalid request: to describe all problems of a large one would delay other requests.
_MAX_PROBLEMS = 100
_MAX_CHARACTERS = 1000


def install_error_handlers(app: FastAPI) -> None:
    """Turn every failure of an app into a problem document."""
    app.add_exception_handler(KleinkramError, _on_kleinkram_error)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(Exception, _on_crash)


def problem_response(error: KleinkramError, request_id: str | None) -> JSONResponse:
    """Return the response for an error."""
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


async def record_refusal(request: Request, error: KleinkramError) -> None:
    """Write a refused request to the audit log."""
    state = request.app.state
    if not hasattr(state, "refusals"):
        state.refusals = Refusals()
    # The route's template, not the address: clients choose that, of any length and content.
    place = f"{request.method} {getattr(request.scope.get('route'), 'path', 'unmatched')}"
    refusal = Refusal(
        actor=getattr(request.state, "actor", None),
        code=error.code,
        place=place,
        why={name: str(value) for name, value in error.fields().items()},
        address=request.client.host if request.client else None,
        request_id=_request_id(request),
        target=request_target(request.path_params, request.query_params),
    )
    await state.refusals.audit(state.database, refusal)


def _request_id(request: Request) -> str | None:
    return getattr(request.state, "request_id", None)


async def _on_kleinkram_error(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, KleinkramError):
        raise error
    if error.status in {401, 403} or error.code in ALSO_REFUSALS:
        await record_refusal(request, error)
    return problem_response(error, _request_id(request))


async def _on_invalid_request(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    problems = [
        FieldProblem(
            field=".".join(str(part)[:_MAX_CHARACTERS] for part in issue["loc"]),
            message=message_of(issue)[:_MAX_CHARACTERS],
        )
        for issue in error.errors()[:_MAX_PROBLEMS]
    ]
    return problem_response(InvalidRequest(problems=problems), _request_id(request))


async def _on_http_exception(request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException):
        raise error
    settings: Settings = request.app.state.settings
    path = request.url.path
    # The client of the original Kleinkram opens a browser with such an address to sign in.
    is_original_sign_in = path.startswith("/auth/") and request.query_params.get("state", "").startswith("cli")
    if error.status_code == 404 and is_page_request(request) and not is_original_sign_in:
        return app_page(settings, status=404)
    problem: KleinkramError
    if error.status_code == 413:
        size_bytes, limit_bytes = map(int, error.detail.split())
        problem = BodyTooLarge(size_bytes=size_bytes, limit_bytes=limit_bytes)
    elif error.status_code == 405:
        problem = MethodNotAllowed(method=request.method, path=path)
    elif error.status_code == 404:
        is_original = is_original_api_path(path)
        problem = WrongClient(server=settings.public_url) if is_original else NotFound(noun="page", ref=path)
    else:
        problem = InvalidRequest(problems=[FieldProblem(field="request", message=str(error.detail))])
    return problem_response(problem, _request_id(request))


async def _on_crash(request: Request, error: Exception) -> JSONResponse:
    request_id = _request_id(request) or "unknown"
    if isinstance(error, ConnectionError | TimeoutError):
        return problem_response(DatabaseUnavailable(), request_id)
    _log.error("crash", exc_info=error, extra={"fields": {"request_id": request_id}})
    return problem_response(InternalError(request_id=request_id), request_id)
