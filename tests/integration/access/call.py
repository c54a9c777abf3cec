"""A call of one operation, as a row of `callers` describes it.

Every row must leave the world as it was: by asking for what changes nothing, for something new, or by its `undo`.
"""

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from kleinkram.contract.access import Scope
from tests.integration.access.expectations import About, Verdict
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
    """How to call an operation, what that is about, and how to read the answer.

    `shows`: of an operation that answers with whatever one may see: whether the thing is in it.
    `hides`: without the right, the thing is not even seen (404, or 410, where others say 403).
    `outcome`: how it went, of an answer that says so for each thing by itself.
    `passes`: the code of a failure that only somebody meets who was let through.
    `needs`: the level that it takes here, where the table says that it is about nothing.
    `scopes`: of which a token must carry one here, where the table says that any will do.
    `via`: the operation under which the request comes in, where it is another one that it turns into.
    `is_boundless`: it is not about any place, so a credential that is limited to some is not for it.
    """

    request: Callable[[Principal], Request]
    about: About
    shows: Callable[[Any, Principal], bool] | None = None
    hides: bool = False
    outcome: Callable[[Any], int] | None = None
    passes: str | None = None
    needs: int | None = None
    scopes: frozenset[Scope] = frozenset(Scope)
    via: str | None = None
    is_boundless: bool = False
    undo: Callable[[Principal], object] | None = None

    def verdict(self, answer: Answer) -> Verdict | int:
        """Return how it went."""
        status = answer.status
        if status == 200 and self.outcome is not None:
            status = self.outcome(answer.body)
        if self.passes is not None and status >= 400 and answer.body["code"] == self.passes:
            return Verdict.done
        if status == 410 and self.hides:
            return Verdict.unseen
        return Verdict.of_status(status)


def new_name() -> str:
    """Return a name that nothing has."""
    return f"new {uuid.uuid4()}"


def get(path: str, /, **query: str) -> Callable[[Principal], Request]:
    """Ask for a page; names of things in braces."""
    return lambda by: Request("GET", filled(path, by), query=tuple((k, filled(v, by)) for k, v in query.items()))


def delete(path: str, /, **query: str) -> Callable[[Principal], Request]:
    """Delete something."""
    return lambda by: Request("DELETE", filled(path, by), query=tuple(query.items()))


def patch(path: str, body: Callable[[Principal], Any]) -> Callable[[Principal], Request]:
    """Change something."""
    return lambda by: Request("PATCH", filled(path, by), body(by))


def post(path: str, body: Callable[[Principal], Any] = lambda _: None) -> Callable[[Principal], Request]:
    """Ask for something to be done."""
    return lambda by: Request("POST", filled(path, by), body(by))


def filled(text: str, by: Principal) -> str:
    """Put the ids of what an principal asks about into a text."""
    return text.format(upload=by.upload, **vars(by.objects))


def lists(attribute: str) -> Callable[[Any, Principal], bool]:
    """Return what says whether a page lists a thing."""

    def shows(page: Any, by: Principal) -> bool:
        return getattr(by.objects, attribute) in {item["id"] for item in page["items"]}

    return shows


def has_items(page: Any, _: Principal) -> bool:
    """Say whether a page lists anything."""
    return bool(page["items"])


def sets(statement: str, *attributes: str) -> Callable[[Principal], object]:
    """Return what runs a statement behind the API's back, with the ids of things."""
    return lambda by: by.api.sql(statement, *(getattr(by.objects, name) for name in attributes))
