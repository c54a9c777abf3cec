"""Error responses: every failure becomes a problem document (RFC 9457), and denials go to the audit log."""

import json
import logging

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

from kleinkram.contract import errors
from kleinkram.contract.problems import message_of, to_problem
from kleinkram.metric_definitions import SIGN_IN_REFUSALS
from kleinkram.server import metrics
from kleinkram.server.access.actor import STRANGER, Actor, ActorKind
from kleinkram.server.audit.log import Event
from kleinkram.server.audit.requests import OTHER_REFUSALS, request_target
from kleinkram.server.http.web_app import app_page, is_original_api_path, is_page_request
from kleinkram.server.settings import Settings

_log = logging.getLogger("kleinkram.http")
# Bounds of the description of one invalid request: to describe all problems of a large one would delay other requests.
_MAX_PROBLEMS = 100
_MAX_CHARACTERS = 1000

# Any operation may fail with any code of the closed list in the schema; clients branch on it (RFC 9457).
FAILURE_RESPONSES: dict[int | str, dict[str, object]] = {
    "default": {
        "description": "A failure as a problem document (RFC 9457), identified by `code`.",
        "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}},
    }
}


def install_error_handlers(app: FastAPI) -> None:
    """Turn every failure of an app into a problem document."""
    app.add_exception_handler(errors.KleinkramError, _on_kleinkram_error)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(Exception, _on_crash)


def problem_response(error: errors.KleinkramError, request_id: str | None) -> JSONResponse:
    """Return the response for an error."""
    metrics.PROBLEMS.labels(error.code.value).inc()
    problem = to_problem(error, request_id)
    headers = {"Retry-After": "2"} if error.status == 503 else {}
    if isinstance(error, errors.RateLimited):
        headers["Retry-After"] = str(error.retry_after_s)
    if error.status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    return JSONResponse(
        json.loads(problem.model_dump_json(exclude_none=True)),
        status_code=error.status,
        media_type="application/problem+json",
        headers=headers,
    )


async def audit_refusal(request: Request, error: errors.KleinkramError) -> None:
    """Count a refused request, and write it to the audit log."""
    if error.code.value in SIGN_IN_REFUSALS.values:
        metrics.SIGN_IN_REFUSALS.labels(error.code.value).inc()
    state = request.app.state
    actor: Actor | None = getattr(request.state, "actor", None)
    address = request.client.host if request.client else None
    guest = STRANGER.for_request("", request_id=_request_id(request), address=address)
    is_known = actor is not None and actor.kind is not ActorKind.stranger
    event = Event(
        OTHER_REFUSALS.get(error.code, "access.denied" if is_known else "auth.refused"),
        "request",
        None,
        # The route's template, not the address: clients choose that, of any length and content.
        f"{request.method} {getattr(request.scope.get('route'), 'path', 'unmatched')}",
        None,
        after={name: str(value) for name, value in error.fields().items()},
    )
    target = None if actor is None else request_target(request.path_params, request.query_params)
    await state.refusals.audit(state.database, actor.without_admin() if actor else guest, event, target)


def _request_id(request: Request) -> str | None:
    return getattr(request.state, "request_id", None)


async def _on_kleinkram_error(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, errors.KleinkramError):
        raise error
    if error.status in {401, 403} or error.code in OTHER_REFUSALS:
        await audit_refusal(request, error)
    return problem_response(error, _request_id(request))


async def _on_invalid_request(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    problems = [
        errors.FieldProblem(
            field=".".join(str(part)[:_MAX_CHARACTERS] for part in issue["loc"]),
            message=message_of(issue)[:_MAX_CHARACTERS],
        )
        for issue in error.errors()[:_MAX_PROBLEMS]
    ]
    return problem_response(errors.InvalidRequest(problems=problems), _request_id(request))


async def _on_http_exception(request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException):
        raise error
    settings: Settings = request.app.state.settings
    path = request.url.path
    # The client of the original Kleinkram opens a browser with such an address to sign in.
    is_original_sign_in = path.startswith("/auth/") and request.query_params.get("state", "").startswith("cli")
    if error.status_code == 404 and is_page_request(request) and not is_original_sign_in:
        return app_page(settings, status=404)
    problem: errors.KleinkramError
    if error.status_code == 413:
        size_bytes, limit_bytes = map(int, error.detail.split())
        problem = errors.BodyTooLarge(size_bytes=size_bytes, limit_bytes=limit_bytes)
    elif error.status_code == 405:
        problem = errors.MethodNotAllowed(method=request.method, path=path)
    elif error.status_code == 404:
        is_original = is_original_api_path(path)
        problem = (
            errors.WrongClient(server=settings.public_url)
            if is_original
            else errors.NotFound(resource_type="page", ref=path)
        )
    else:
        problem = errors.InvalidRequest(problems=[errors.FieldProblem(field="request", message=str(error.detail))])
    return problem_response(problem, _request_id(request))


async def _on_crash(request: Request, error: Exception) -> JSONResponse:
    request_id = _request_id(request) or "unknown"
    if isinstance(error, ConnectionError | TimeoutError):
        return problem_response(errors.DatabaseUnavailable(), request_id)
    _log.error("crash", exc_info=error)
    return problem_response(errors.InternalError(request_id=request_id), request_id)
