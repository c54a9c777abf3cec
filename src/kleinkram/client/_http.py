"""The one door to the API: a request goes in as a model, comes out as a model or as a named error.

Never moves the bytes of files; those go straight to the store (`transfer/`). Safe to share between threads.
"""

import datetime
import enum
import json
import logging
import math
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from email.utils import parsedate_to_datetime
from typing import Any, TypeVar
from urllib.parse import urlencode

import urllib3
from pydantic import BaseModel, ValidationError

import kleinkram
from kleinkram.client._network import WatchedPools
from kleinkram.client._retry import Backoff
from kleinkram.client.config import TOKEN_VARIABLE, Endpoint
from kleinkram.client.errors import (
    AnswerNotUnderstood,
    ServerUnreachable,
    StoreUnreachable,
    remember_request,
)
from kleinkram.contract.errors import KleinkramError, NotAuthenticated
from kleinkram.contract.problems import ProblemDocument, first_problem, from_problem

T = TypeVar("T", bound=BaseModel)
_log = logging.getLogger("kleinkram.http")

CONNECT_TIMEOUT_S = 10.0
READ_TIMEOUT_S = 60.0
PATIENCE_S = 4.0
# Whoever follows events waits for longer than a server takes to start again.
_RESTART_S = 60.0
_RETRIED_STATUS = frozenset({429, 502, 503, 504})
_TOO_OFTEN = 429
# Without a problem document they are the words of a proxy whose server is away.
_OF_PROXIES = frozenset({502, 503, 504})
_SAME_TIME = datetime.timedelta(seconds=5)
_NEVER_SENT = (urllib3.exceptions.NewConnectionError, urllib3.exceptions.ConnectTimeoutError)


def query_of(model: BaseModel | None, **more: object) -> list[tuple[str, str]]:
    """Return what a filter says as query parameters: lists repeated, what is not said left out."""
    said: dict[str, object] = model.model_dump(mode="json", exclude_defaults=True) if model else {}
    pairs: list[tuple[str, str]] = []
    for key, value in {**said, **more}.items():
        values = value if isinstance(value, list) else [value]
        pairs += [(key, _text(one)) for one in values if one is not None]
    return pairs


def _text(value: object) -> str:
    if isinstance(value, enum.Enum):
        return str(value.value)
    return ("true" if value else "false") if isinstance(value, bool) else str(value)


class Api:
    """A connection to one server's API."""

    def __init__(self, endpoint: Endpoint, *, read_timeout_s: float = READ_TIMEOUT_S, is_patient: bool = True) -> None:
        self.endpoint = endpoint
        self._is_patient = is_patient
        self._base = f"{endpoint.url}/api/v1"
        timeout = urllib3.Timeout(connect=min(CONNECT_TIMEOUT_S, read_timeout_s), read=read_timeout_s)
        self._pool = WatchedPools(maxsize=8, timeout=timeout)
        self._server_ahead = datetime.timedelta(0)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle which server it is; connections are made anew."""
        return Api, (self.endpoint,)

    def now(self) -> datetime.datetime:
        """Return what time it is at the server (aware), as its last answer told: all that ends, ends by its clock."""
        return datetime.datetime.now(datetime.timezone.utc) + self._server_ahead

    def close(self) -> None:
        """Close the connections."""
        self._pool.clear()

    def get(self, path: str, kind: type[T], query: list[tuple[str, str]] | None = None) -> T:
        """Return what a path answers; tried again when the server is briefly away."""
        return self.understood(kind, f"GET {path}", self._request("GET", path, query=query or []))

    def stream(self, path: str, kind: type[T], query: list[tuple[str, str]] | None = None) -> Iterator[T]:
        """Yield what a path answers line by line, as it comes; tried again only before its first line.

        Raises:
            ServerUnreachable: the answer broke off.
        """
        answer = self._answer("GET", path, query=query or [], whole=False)
        try:
            for line in answer:
                yield self.understood(kind, f"GET {path}", line)
        except urllib3.exceptions.HTTPError as error:
            raise self._unreachable(error) from error
        finally:
            answer.close()

    def events(self, path: str, *, after: str | None, for_s: float | None) -> Iterator[tuple[str, str]]:
        """Yield a stream's events as (name, data), and their ids as ("id", id), until it ends or breaks off."""
        answer = self._answer(
            "GET", path, query=query_of(None, after=after, for_s=for_s), patience_s=_RESTART_S, whole=False
        )
        name = ""
        try:
            for line in _lines(answer):
                field, _, value = line.partition(": ")
                if field == "event":
                    name = value
                elif field == "id":
                    yield "id", value
                elif field == "data":
                    yield name, value
        except urllib3.exceptions.HTTPError:
            return  # to be followed again from the last id
        finally:
            answer.close()

    def send(
        self, method: str, path: str, kind: type[T], body: BaseModel | None = None, *, etag: str | None = None
    ) -> T:
        """Ask for a change and return its answer; not tried again once the server may have seen it.

        With an `etag`, only where what is changed is still that.
        """
        answer = self._request(method, path, body=body, idempotent=False, etag=etag)
        return self.understood(kind, f"{method} {path}", answer)

    def repeat(
        self,
        path: str,
        kind: type[T],
        body: BaseModel,
        *,
        patience_s: float = PATIENCE_S,
        wait: Callable[[float], object] | None = None,
    ) -> T:
        """POST something that may be said twice (asking for links, signing), for as long as patience lasts."""
        answer = self._request("POST", path, body=body, patience_s=patience_s, wait=wait)
        return self.understood(kind, f"POST {path}", answer)

    def tell(
        self,
        path: str,
        body: BaseModel,
        *,
        patience_s: float = PATIENCE_S,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        """POST something that may be said twice and has no answer."""
        self._request("POST", path, body=body, patience_s=patience_s, wait=wait)

    def patch(self, path: str, kind: type[T], body: BaseModel, *, etag: str | None = None) -> T:
        """Change a noun: only fields that were set in `body` travel. With an `etag`, only where it is still that."""
        answer = self._request("PATCH", path, body=body, etag=etag)
        return self.understood(kind, f"PATCH {path}", answer)

    def delete(self, path: str, query: list[tuple[str, str]] | None = None) -> bytes:
        """Delete a noun and return the answer's body."""
        return self._request("DELETE", path, query=query or [], idempotent=False)

    def post_empty(self, path: str) -> bytes:
        """POST without a body, to something that may be asked for twice, and return the answer's body."""
        return self._request("POST", path)

    def understood(self, kind: type[T], what: str, answer: bytes) -> T:
        """Return an answer's body as a model.

        Raises:
            AnswerNotUnderstood: it is not one; server and client are of different versions, or it is no Kleinkram.
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
        patience_s: float = PATIENCE_S,
        wait: Callable[[float], object] | None = None,
        whole: bool = True,
        etag: str | None = None,
    ) -> urllib3.BaseHTTPResponse:
        backoff: Backoff | None = None
        url = self._base + path
        patience_s = patience_s if self._is_patient else 0.0
        content = None if body is None else body.model_dump_json(exclude_unset=True).encode()
        while True:
            request_id = uuid.uuid4().hex
            said = {"X-Request-Id": request_id} | ({} if etag is None else {"If-Match": f'"{etag}"'})
            try:
                answer = self._once(method, f"{url}?{urlencode(query)}" if query else url, content, said, whole)
            except urllib3.exceptions.HTTPError as error:
                backoff = backoff or _backoff(patience_s, wait)
                if (idempotent or isinstance(error, _NEVER_SENT)) and backoff.pause():
                    continue
                raise remember_request(self._unreachable(error), request_id) from error
            if answer.status < 300:
                return answer
            backoff = backoff or _backoff(patience_s, wait)
            if answer.status == _TOO_OFTEN and backoff.wait_retry_after(_retry_after_s(answer.headers)):
                continue  # nothing was done yet, so this holds for changes too
            if answer.status in _RETRIED_STATUS and idempotent and backoff.pause(_retry_after_s(answer.headers)):
                continue
            raise self._failure(f"{method} {path}", answer, request_id)

    def _once(
        self, method: str, target: str, content: bytes | None, said: Mapping[str, str], whole: bool
    ) -> urllib3.BaseHTTPResponse:
        headers = {
            "User-Agent": f"klein/{kleinkram.__version__}",
            "Accept": "application/json",
            **said,
        }
        if self.endpoint.token is not None:
            headers["Authorization"] = f"Bearer {self.endpoint.token}"
        if content is not None:
            headers["Content-Type"] = "application/json"
        began_at, status = time.monotonic(), "no answer"
        try:
            answer = self._pool.request(
                method, target, body=content, headers=headers, redirect=False, preload_content=whole
            )
            status = str(answer.status)
        finally:
            path = target.removeprefix(self.endpoint.url).partition("?")[0]  # a query may hold what is secret
            milliseconds = (time.monotonic() - began_at) * 1000
            _log.debug("%s %s: %s in %.0f ms (request %s)", method, path, status, milliseconds, said["X-Request-Id"])
        self._hear(answer.headers.get("Date"))
        return answer

    def _hear(self, date: str | None) -> None:
        try:
            told = parsedate_to_datetime(date) if date else None
        except ValueError:  # a proxy's invention
            return
        if told is not None and told.tzinfo is not None:
            ahead = told - datetime.datetime.now(datetime.timezone.utc)
            # A date is in whole seconds, and old by the time that it took to come.
            self._server_ahead = ahead if abs(ahead) > _SAME_TIME else datetime.timedelta(0)

    def _unreachable(self, error: urllib3.exceptions.HTTPError) -> ServerUnreachable:
        return ServerUnreachable(url=self.endpoint.url, reason=reason_of(error))

    def _strange(self, what: str, answer: urllib3.BaseHTTPResponse) -> KleinkramError:
        if answer.status in _OF_PROXIES:
            return ServerUnreachable(url=self.endpoint.url, reason=f"what stands before it says {answer.status}")
        return self._not_understood(what, f"status {answer.status}{_said(answer.data)}")

    def _failure(self, what: str, answer: urllib3.BaseHTTPResponse, request_id: str) -> KleinkramError:
        try:
            problem = ProblemDocument.model_validate_json(answer.data)
        except ValidationError:
            return remember_request(self._strange(what, answer), answer.headers.get("X-Request-Id", request_id))
        error = from_problem(problem)
        if isinstance(error, NotAuthenticated):
            error = NotAuthenticated(error.reason + _whose(self.endpoint), server=self.endpoint.url)
        return remember_request(error, problem.request_id or request_id)


def _backoff(patience_s: float, wait: Callable[[float], object] | None) -> Backoff:
    """Begin to be patient: at the first failure, since an answer that was waited for may break off after long."""
    return Backoff(patience_s, wait) if wait else Backoff(patience_s)


def _lines(answer: urllib3.BaseHTTPResponse) -> Iterator[str]:
    """Yield the lines of an answer, each as soon as it is there."""
    rest = b""
    for piece in answer.stream():
        *lines, rest = (rest + piece).split(b"\n")
        yield from (line.decode() for line in lines)


def _whose(endpoint: Endpoint) -> str:
    """Return where a token that is not welcome came from, where signing in would not replace it."""
    given = endpoint.token is not None and endpoint.token == os.environ.get(TOKEN_VARIABLE)
    return f" (it is the one in {TOKEN_VARIABLE})" if given else ""


def _said(body: bytes) -> str:
    """Return what a failure that this client has no class for says of itself: a newer server's, or a proxy's."""
    try:
        problem = json.loads(body)
    except ValueError:
        return " without a word that it knows"
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
