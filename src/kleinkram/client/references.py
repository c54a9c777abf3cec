"""From what a person calls a noun (its id, its name, a glob) to the one noun meant."""

from collections.abc import Callable, Iterable
from typing import TypeVar

from kleinkram.contract.errors import AmbiguousName, NotFound
from kleinkram.contract.names import name_key

T = TypeVar("T")

_SHOWN_CANDIDATES = 20


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
