"""Calls of one operation, as the rows of `callers` describe them.

Every call must leave the objects unchanged: because the request changes nothing, because it creates a new object, or by
its `undo`.
"""

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kleinkram.contract.access import Scope
from tests.integration.access.expectations import Target, Verdict
from tests.integration.access.world import Principal
from tests.integration.api_server import Answer


@dataclass(frozen=True)
class Request:
    """One request to the API."""

    method: str
    path: str
    body: Any = None
    query: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Caller:
    """How to call an operation, the target of the call, and how to read the response.

    `shows`: for operations that return all visible objects: whether the response contains the target.
    `hides`: without the right, the response is 404 or 410, where other operations return 403.
    `outcome`: the status of the target, for responses with a result per object.
    `accepted_code`: an error code that only requests with sufficient rights receive; it counts as success.
    `required_level`: the level that the call requires, if the table of operations has none.
    `scopes`: scopes of which a token needs one, if the table of operations accepts any.
    `via`: the operation of the route, if the request turns into another one.
    `needs_unlimited_credential`: the call has no project or mission, so limited credentials are refused.
    """

    request: Callable[[Principal], Request]
    target: Target
    shows: Callable[[Any, Principal], bool] | None = None
    hides: bool = False
    outcome: Callable[[Any], int] | None = None
    accepted_code: str | None = None
    required_level: int | None = None
    scopes: frozenset[Scope] = frozenset(Scope)
    via: str | None = None
    needs_unlimited_credential: bool = False
    undo: Callable[[Principal], object] | None = None

    def verdict(self, answer: Answer) -> Verdict | int:
        """Return the verdict of a response."""
        status = answer.status
        if status == 200 and self.outcome is not None:
            status = self.outcome(answer.body)
        if self.accepted_code is not None and status >= 400 and answer.body["code"] == self.accepted_code:
            return Verdict.ok
        if status == 410 and self.hides:
            return Verdict.not_found
        return Verdict.of_status(status)


def new_name() -> str:
    """Return an unused name."""
    return f"new {uuid.uuid4()}"


def get(path: str, /, **query: str) -> Callable[[Principal], Request]:
    """Return a GET request; ids of objects are fields in braces."""
    return lambda principal: Request(
        "GET", fill(path, principal), query=tuple((k, fill(v, principal)) for k, v in query.items())
    )


def delete(path: str, /, **query: str) -> Callable[[Principal], Request]:
    """Return a DELETE request."""
    return lambda principal: Request("DELETE", fill(path, principal), query=tuple(query.items()))


def patch(path: str, body: Callable[[Principal], Any]) -> Callable[[Principal], Request]:
    """Return a PATCH request."""
    return lambda principal: Request("PATCH", fill(path, principal), body(principal))


def post(path: str, body: Callable[[Principal], Any] = lambda _: None) -> Callable[[Principal], Request]:
    """Return a POST request."""
    return lambda principal: Request("POST", fill(path, principal), body(principal))


def put(path: str, body: Callable[[Principal], Any]) -> Callable[[Principal], Request]:
    """Return a PUT request."""
    return lambda principal: Request("PUT", fill(path, principal), body(principal))


def fill(text: str, principal: Principal) -> str:
    """Insert the ids of a principal's objects into a text."""
    return text.format(upload=principal.upload, **vars(principal.objects))


def lists(attribute: str) -> Callable[[Any, Principal], bool]:
    """Return a function that tells whether a page lists an object."""

    def shows(page: Any, principal: Principal) -> bool:
        return getattr(principal.objects, attribute) in {item["id"] for item in page["items"]}

    return shows


def has_items(page: Any, _: Principal) -> bool:
    """Whether a page lists anything."""
    return bool(page["items"])


def sets(statement: str, *attributes: str) -> Callable[[Principal], object]:
    """Return a function that runs a statement directly in the database, with the ids of these objects."""
    return lambda principal: principal.api.sql(statement, *(getattr(principal.objects, name) for name in attributes))
