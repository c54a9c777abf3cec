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


def path_matches(path: str, glob: str) -> bool:
    """Return whether a path, or what is below one of its folders, matches a glob.

    `nuc/*` also matches `day1/nuc/drive.mcap`, so that it does not matter from which folder files are uploaded; a
    glob that begins with `/` is of the whole path.
    """
    if glob.startswith("/"):
        return matches(path, glob[1:])
    return matches(path, glob) or matches(path, f"*/{glob}")
