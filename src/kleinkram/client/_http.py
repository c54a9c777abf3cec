"""Requests to the API: a model goes in; a model or a named error comes out. Safe to share between threads.

The bytes of files go straight to the store (`transfer/`).
"""

import copy
import datetime
import enum
import functools
import json
import logging
import math
import os
import random
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from email.utils import parsedate_to_datetime
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlencode, urlsplit

import urllib3
from pydantic import BaseModel, ValidationError
from typing_extensions import Self

import kleinkram
from kleinkram import traces
from kleinkram.client._network import WatchedPools
from kleinkram.client.config import TOKEN_VARIABLE, Endpoint
from kleinkram.client.errors import AnswerNotUnderstood, ServerUnreachable, StoreUnreachable, remember_request
from kleinkram.contract.errors import KleinkramError, NotAuthenticated
from kleinkram.contract.problems import ProblemDocument, first_problem, from_problem

if TYPE_CHECKING:
    from kleinkram.recordings.http_source import HttpConnections

T = TypeVar("T", bound=BaseModel)
_log = logging.getLogger("kleinkram.http")

CONNECT_TIMEOUT_S = 10.0
READ_TIMEOUT_S = 60.0
RETRY_TIMEOUT_S = 4.0
# For event streams: longer than a server takes to start again.
_RESTART_S = 60.0
_RETRIED_STATUS = frozenset({429, 502, 503, 504})
_TOO_OFTEN = 429
# Without a problem document, these come from a proxy whose server is unavailable.
_OF_PROXIES = frozenset({502, 503, 504})
_SAME_TIME = datetime.timedelta(seconds=5)
_NEVER_SENT = (urllib3.exceptions.NewConnectionError, urllib3.exceptions.ConnectTimeoutError)


FIRST_WAIT_S = 0.25
LONGEST_WAIT_S = 4.0
# How long in total a request waits for `Retry-After`: a rate limit ends within a minute.
LONGEST_RETRY_AFTER_S = 90.0


class Backoff:
    """The waits between tries: growing, with jitter, for `timeout_s` in total. Not shared between threads.

    `wait` waits (seconds); that of a transfer ends when the transfer is stopped.
    """

    def __init__(self, timeout_s: float, wait: Callable[[float], object] | None = None) -> None:
        self._began_at = time.monotonic()
        self._ends_at = self._began_at + timeout_s
        self._next_s = FIRST_WAIT_S
        self._retry_after_left_s = LONGEST_RETRY_AFTER_S
        self._wait = wait or time.sleep

    def lasting_s(self) -> float:
        """Return how long it has been tried."""
        return time.monotonic() - self._began_at

    def extend(self, waited_s: float) -> None:
        """Extend the timeout by the time that something else took."""
        self._ends_at += waited_s

    def wait_retry_after(self, wait_s: float) -> bool:
        """Wait as long as the server says, beyond the timeout; return False, without waiting, if that is too long."""
        if not 0 < wait_s <= self._retry_after_left_s:
            return False
        self._retry_after_left_s -= wait_s
        self._ends_at += wait_s
        self._wait(wait_s)
        return True

    def pause(self, at_least_s: float = 0.0) -> bool:
        """Wait before the next try; return False, without waiting, after the timeout."""
        wait_s = max(at_least_s, self._next_s * random.uniform(0.5, 1.0))  # noqa: S311  jitter is no secret
        self._next_s = min(self._next_s * 2, LONGEST_WAIT_S)
        if time.monotonic() + wait_s > self._ends_at:
            return False
        self._wait(wait_s)
        return True


def query_of(model: BaseModel | None, **more: object) -> list[tuple[str, str]]:
    """Return a filter as query parameters: lists repeated, unset fields left out."""
    fields: dict[str, object] = model.model_dump(mode="json", exclude_defaults=True) if model else {}
    pairs: list[tuple[str, str]] = []
    for key, value in {**fields, **more}.items():
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, bool):
                pairs.append((key, "true" if one else "false"))
            elif one is not None:
                pairs.append((key, str(one.value if isinstance(one, enum.Enum) else one)))
    return pairs


class Api:
    """A connection to one server's API."""

    def __init__(
        self, endpoint: Endpoint, *, read_timeout_s: float = READ_TIMEOUT_S, retry_timeout_s: float = RETRY_TIMEOUT_S
    ) -> None:
        self.endpoint = endpoint
        self._retry_timeout_s = retry_timeout_s
        self._wait: Callable[[float], object] | None = None
        self._base = f"{endpoint.url}/api/v1"
        timeout = urllib3.Timeout(connect=min(CONNECT_TIMEOUT_S, read_timeout_s), read=read_timeout_s)
        self._pool = WatchedPools(maxsize=8, timeout=timeout)
        self._server_ahead = datetime.timedelta(0)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle which server it is; connections are not pickled."""
        return Api, (self.endpoint,)

    def with_retry(self, timeout_s: float, wait: Callable[[float], object]) -> Self:
        """Return this connection with another retry timeout; `wait` waits between tries (seconds)."""
        other = copy.copy(self)
        other._retry_timeout_s, other._wait = timeout_s, wait
        return other

    @functools.cached_property
    def store_connections(self) -> "HttpConnections":
        """Connections for reading from the store: the same for all recordings, so that few are open."""
        from kleinkram.recordings.http_source import HttpConnections  # only reading needs it
        from kleinkram.recordings.limits import PARALLEL_READS

        return HttpConnections(PARALLEL_READS)

    def now(self) -> datetime.datetime:
        """Return the time at the server (aware), by its last answer: its clock decides what has expired."""
        return datetime.datetime.now(datetime.timezone.utc) + self._server_ahead

    def close(self) -> None:
        """Close the connections."""
        self._pool.clear()

    def get(self, path: str, kind: type[T], query: list[tuple[str, str]] | None = None) -> T:
        """GET a path; retried while the server is briefly unavailable."""
        return self.parse_response(kind, f"GET {path}", self._request("GET", path, query=query or []))

    def stream(self, path: str, kind: type[T], query: list[tuple[str, str]] | None = None) -> Iterator[T]:
        """Yield the answer of a path line by line; raise ServerUnreachable where it breaks off."""
        answer = self._answer("GET", path, query=query or [], whole=False)
        try:
            for line in answer:
                yield self.parse_response(kind, f"GET {path}", line)
        except urllib3.exceptions.HTTPError as error:
            raise ServerUnreachable(url=self.endpoint.url, reason=reason_of(error)) from error
        finally:
            answer.close()

    def events(self, path: str, *, after: str | None, for_s: float | None) -> Iterator[tuple[str, str]]:
        """Yield a stream's events as (name, data), and their ids as ("id", id), until it ends or breaks off."""
        patient = self.with_retry(_RESTART_S, time.sleep)
        answer = patient._answer("GET", path, query=query_of(None, after=after, for_s=for_s), whole=False)
        name = ""
        try:
            rest = b""
            for piece in answer.stream():
                *lines, rest = (rest + piece).split(b"\n")
                for line in lines:
                    field, _, value = line.decode().partition(": ")
                    if field == "event":
                        name = value
                    elif field == "id":
                        yield "id", value
                    elif field == "data":
                        yield name, value
        except urllib3.exceptions.HTTPError:
            return  # the caller follows again from the last id
        finally:
            answer.close()

    def send(
        self, method: str, path: str, kind: type[T], body: BaseModel | None = None, *, etag: str | None = None
    ) -> T:
        """Send a change; not retried once the server may have seen it. With an `etag`, only if it still has that."""
        answer = self._request(method, path, body=body, idempotent=False, etag=etag)
        return self.parse_response(kind, f"{method} {path}", answer)

    def repeat(self, path: str, kind: type[T], body: BaseModel | None = None) -> T:
        """POST something idempotent, such as signing; retried until the timeout."""
        return self.parse_response(kind, f"POST {path}", self.post(path, body))

    def patch(self, path: str, kind: type[T], body: BaseModel, *, etag: str | None = None) -> T:
        """PATCH with the fields that were set in `body`. With an `etag`, only if it still has that."""
        answer = self._request("PATCH", path, body=body, etag=etag)
        return self.parse_response(kind, f"PATCH {path}", answer)

    def delete(self, path: str, query: list[tuple[str, str]] | None = None) -> bytes:
        """DELETE, and return the answer's body."""
        return self._request("DELETE", path, query=query or [], idempotent=False)

    def post(self, path: str, body: BaseModel | None = None) -> bytes:
        """POST something idempotent, and return the answer's body."""
        return self._request("POST", path, body=body)

    def parse_response(self, kind: type[T], what: str, answer: bytes) -> T:
        """Return an answer's body as a model.

        Raises:
            AnswerNotUnderstood: it is not one: the server has another version, or is no Kleinkram.
        """
        try:
            return kind.model_validate_json(answer)
        except ValidationError as error:
            raise self._not_understood(what, first_problem(error)) from None

    def _not_understood(self, what: str, reason: str) -> AnswerNotUnderstood:
        return AnswerNotUnderstood(
            url=self.endpoint.url, what=what, client_version=kleinkram.__version__, reason=reason
        )

    def _request(self, method: str, path: str, **how: Any) -> bytes:  # Any: as `_answer` takes them
        return self._answer(method, path, **how).data

    def _answer(
        self,
        method: str,
        path: str,
        *,
        query: list[tuple[str, str]] | None = None,
        body: BaseModel | None = None,
        idempotent: bool = True,
        whole: bool = True,
        etag: str | None = None,
    ) -> urllib3.BaseHTTPResponse:
        backoff: Backoff | None = None  # begins at the first failure: an answer may break off after long
        url = self._base + path
        content = None if body is None else body.model_dump_json(exclude_unset=True).encode()
        while True:
            request_id = uuid.uuid4().hex
            fields = {"X-Request-Id": request_id} | ({} if etag is None else {"If-Match": f'"{etag}"'})
            try:
                answer = self._once(method, f"{url}?{urlencode(query)}" if query else url, content, fields, whole)
            except urllib3.exceptions.HTTPError as error:
                backoff = backoff or Backoff(self._retry_timeout_s, self._wait)
                if (idempotent or isinstance(error, _NEVER_SENT)) and backoff.pause():
                    continue
                unreachable = ServerUnreachable(url=self.endpoint.url, reason=reason_of(error))
                raise remember_request(unreachable, request_id) from error
            if answer.status < 300:
                return answer
            backoff = backoff or Backoff(self._retry_timeout_s, self._wait)
            if answer.status == _TOO_OFTEN and backoff.wait_retry_after(_retry_after_s(answer.headers)):
                continue  # nothing was done yet, so this holds for changes too
            if answer.status in _RETRIED_STATUS and idempotent and backoff.pause(_retry_after_s(answer.headers)):
                continue
            raise self._failure(f"{method} {path}", answer, request_id)

    def _once(
        self, method: str, target: str, content: bytes | None, fields: Mapping[str, str], whole: bool
    ) -> urllib3.BaseHTTPResponse:
        headers = {"User-Agent": f"klein/{kleinkram.__version__}", "Accept": "application/json", **fields}
        if self.endpoint.token is not None:
            headers["Authorization"] = f"Bearer {self.endpoint.token}"
        if content is not None:
            headers["Content-Type"] = "application/json"
        began_at, status = time.monotonic(), "no answer"
        try:
            answer = self._exchange(method, target, content, headers, whole)
            status = str(answer.status)
        finally:
            path = target.removeprefix(self.endpoint.url).partition("?")[0]  # a query may hold what is secret
            milliseconds = (time.monotonic() - began_at) * 1000
            _log.debug("%s %s: %s in %.0f ms (request %s)", method, path, status, milliseconds, fields["X-Request-Id"])
        with suppress(ValueError):  # a date that a proxy made up
            date = answer.headers.get("Date")
            server_time = parsedate_to_datetime(date) if date else None
            if server_time is not None and server_time.tzinfo is not None:
                ahead = server_time - datetime.datetime.now(datetime.timezone.utc)
                # A date is in whole seconds, and old by the time that it took to come.
                self._server_ahead = ahead if abs(ahead) > _SAME_TIME else datetime.timedelta(0)
        return answer

    def _exchange(
        self, method: str, target: str, content: bytes | None, headers: Mapping[str, str], whole: bool
    ) -> urllib3.BaseHTTPResponse:
        def request(more: Mapping[str, str]) -> urllib3.BaseHTTPResponse:
            return self._pool.request(
                method, target, body=content, headers={**headers, **more}, redirect=False, preload_content=whole
            )

        if not traces.is_on():
            return request({})
        with traces.leaf_span(method, self._span_attributes(method, target)) as span:
            parent = span.traceparent or traces.traceparent()  # the second where traces are not sampled
            answer = request({} if parent is None else {"traceparent": parent})
            span.set({"http.response.status_code": answer.status})
            if answer.status >= 400:
                span.fail(str(answer.status))
            return answer

    def _span_attributes(self, method: str, target: str) -> traces.Attributes:
        server = urlsplit(self.endpoint.url)
        path = target.removeprefix(self.endpoint.url).partition("?")[0]
        attributes: dict[str, str | int] = {"http.request.method": method, "url.path": path}
        attributes["server.address"] = server.hostname or ""
        return attributes if server.port is None else {**attributes, "server.port": server.port}

    def _failure(self, what: str, answer: urllib3.BaseHTTPResponse, request_id: str) -> KleinkramError:
        error: KleinkramError
        try:
            problem = ProblemDocument.model_validate_json(answer.data)
        except ValidationError:
            if answer.status in _OF_PROXIES:
                reason = f"what stands before it says {answer.status}"
                error = ServerUnreachable(url=self.endpoint.url, reason=reason)
            else:
                error = self._not_understood(what, f"status {answer.status}{_detail(answer.data)}")
            return remember_request(error, answer.headers.get("X-Request-Id", request_id))
        error = from_problem(problem)
        if isinstance(error, NotAuthenticated):
            token = self.endpoint.token
            is_from_environment = token is not None and token == os.environ.get(TOKEN_VARIABLE)
            source = f" (it is the one in {TOKEN_VARIABLE})" if is_from_environment else ""
            error = NotAuthenticated(error.reason + source, server=self.endpoint.url)
        return remember_request(error, problem.request_id or request_id)


def _detail(body: bytes) -> str:
    """Return the detail of a failure without a class here: of a newer server, or a proxy."""
    detail = None
    with suppress(ValueError):
        problem = json.loads(body)
        detail = problem.get("detail") if isinstance(problem, dict) else None
    return f", {detail}" if isinstance(detail, str) else " without a word that it knows"


def _retry_after_s(headers: Mapping[str, str]) -> float:
    try:
        wait_s = float(headers.get("Retry-After", "0"))
    except ValueError:
        return 0.0
    return wait_s if math.isfinite(wait_s) else 0.0


def reason_of(error: BaseException) -> str:
    """Return why a connection failed, in a few words and without the addresses of objects."""
    cause: Any = error  # Any: urllib3 hides causes in several untyped attributes
    while (inner := getattr(cause, "reason", None) or cause.__cause__ or cause.__context__) is not None:
        if not isinstance(inner, BaseException):
            break
        cause = inner
    if isinstance(cause, urllib3.exceptions.TimeoutError | TimeoutError):
        return "it took too long"
    text = getattr(cause, "strerror", None) or str(cause).rpartition(": ")[2] or type(cause).__name__
    return str(text)


def store_unreachable(url: str, reason: str) -> StoreUnreachable:
    """Return the error for a store that cannot be used, naming it without the signature in its URL."""
    parsed = urllib3.util.parse_url(url)
    return StoreUnreachable(store=f"{parsed.scheme}://{parsed.netloc}", reason=reason)
