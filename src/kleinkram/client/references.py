"""From what a person calls a noun (its id, its name, a glob) to the one noun meant."""

import uuid
from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar

from kleinkram.client.errors import InvalidInput
from kleinkram.contract.errors import AmbiguousName, NotFound
from kleinkram.contract.names import is_id, name_key

T = TypeVar("T")

_SHOWN_CANDIDATES = 20


class HasId(Protocol):
    """A noun as a list or `get` returned it."""

    @property
    def id(self) -> uuid.UUID:
        """Its id."""


Ref = str | uuid.UUID | HasId
"""What stands for a noun: its name, its id (a UUID or text), or the noun itself."""


def known_id(ref: Ref, noun: str) -> uuid.UUID | None:
    """Return the id that a reference is or has; None for a name.

    Raises:
        InvalidInput: it is none of these.
    """
    if isinstance(ref, str):
        return uuid.UUID(ref) if is_id(ref) else None
    found = ref if isinstance(ref, uuid.UUID) else getattr(ref, "id", None)
    if not isinstance(found, uuid.UUID):
        raise InvalidInput(what=f"The {noun} {ref!r}", reason="give its name, its id, or what a list returned")
    return found


def refs_of(noun: str, value: object) -> list[object]:
    """Return one reference or several as a list.

    Raises:
        InvalidInput: there is none, which would stand for all.
    """
    several = [*value] if isinstance(value, list | tuple | set | frozenset) else [value]
    if not several:
        raise InvalidInput(what=f"The filter ({noun})", reason="it names none; leave it out where all are meant")
    return several


def is_glob(ref: str) -> bool:
    """Say whether a reference may stand for many."""
    return "*" in ref or "?" in ref


def the_one(noun: str, ref: str, rows: Iterable[T], *, name: Callable[[T], str], label: Callable[[T], str]) -> T:
    """Return the row that `ref` names, letter case and Unicode form apart; a glob may match just one.

    Raises:
        NotFound: none does.
        AmbiguousName: several do; lists them by `label`.
    """
    found = list(rows)
    exact = [row for row in found if name_key(name(row)) == name_key(ref)]
    if not exact and is_glob(ref):
        exact = found
    if not exact:
        raise NotFound(noun=noun, ref=ref)
    if len(exact) > 1:
        raise AmbiguousName(noun=noun, ref=ref, candidates=[label(row) for row in exact[:_SHOWN_CANDIDATES]])
    return exact[0]
