"""Globs of names: `*` also matches `/`, `?` one character, `[…]` one of several; letters are distinguished by case."""

import re
from collections.abc import Callable
from fnmatch import translate
from functools import lru_cache

_WILDCARDS = frozenset("*?[")


@lru_cache(maxsize=4096)
def glob_matcher(glob: str) -> Callable[[str], object] | None:
    """Return a function that is true for the names that match; None for a glob that is a plain name."""
    return re.compile(translate(glob)).match if _WILDCARDS.intersection(glob) else None


def matches(name: str, glob: str) -> bool:
    """Return whether a name matches a glob."""
    matcher = glob_matcher(glob)
    return name == glob if matcher is None else bool(matcher(name))
