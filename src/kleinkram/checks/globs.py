"""Globs of names: `*` also matches `/`, `?` one character, `[…]` one of several; letters are distinguished by case.

A comparison never goes back to a `*` that it passed. What the comparisons of a mission cost is counted, so that no
`checks.yaml` keeps the server busy.
"""

import re
from collections.abc import Callable, Collection, Iterable
from fnmatch import translate
from functools import lru_cache

_WILDCARDS = frozenset("*?[")
_SEVERAL_STARS = re.compile(r"\*+")
MAX_STARS = 16
"""In a glob of a rule."""
MAX_STEPS = 300_000_000
"""Of one mission: at most 0.6 s. 500 globs and 2,000 topics take a third, if what follows a `*` is short."""
_STEPS_OF_GLOB, _STEPS_OF_NAME = 50_000, 100
MAX_MATCHED_CHARACTERS = 1000
"""Of the texts of one metadata field that globs are compared with."""
_CHARACTERS_OF_TEXT = 10


class TooManyComparisons(Exception):
    """The rules compare their globs with too many names; checks beyond that are not made."""

    def __str__(self) -> str:
        return "the rules compare their globs with too many names of this mission; the other checks were not made"


@lru_cache(maxsize=4096)
def glob_matcher(glob: str) -> Callable[[str], object] | None:
    """Return a function that is true for the names that match; None for a glob that is a plain name."""
    return re.compile(translate(_SEVERAL_STARS.sub("*", glob))).match if is_glob(glob) else None


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


def is_glob(text: str) -> bool:
    """Return whether a text has a wildcard."""
    return not _WILDCARDS.isdisjoint(text)


class TextsToMatch:
    """Texts of any length and number that globs are compared with: the first that have 1,000 characters together.

    Each counts as 10 characters more, so that there are about 100. The others match no glob.
    """

    def __init__(self, texts: Iterable[str]) -> None:
        self.texts: list[str] = []
        left = MAX_MATCHED_CHARACTERS
        for text in texts:
            if len(text) <= left:
                self.texts.append(text)
                left -= len(text) + _CHARACTERS_OF_TEXT

    def any_matches(self, glob: str) -> bool:
        """Return whether a glob matches one of them."""
        return any(matches(text, glob) for text in self.texts)


def check_rule_glob(glob: str) -> str:
    """Return a glob of a rule. Raises ValueError if it has very many `*`."""
    if (stars := len(_SEVERAL_STARS.findall(glob))) > MAX_STARS:
        raise ValueError(f"a glob with {stars} `*`; at most {MAX_STARS} are allowed")
    return glob


class Comparisons:
    """Counts the steps of comparing the globs of rules with the names of one mission."""

    def __init__(self, names: Collection[str]) -> None:
        self._count, self._characters, self._left = len(names), sum(map(len, names)), MAX_STEPS

    def add(self, glob: str, times: int = 1) -> None:
        """Count the comparison of a glob with all names, and its compilation. Raises TooManyComparisons."""
        # What follows a `*`, up to the next one, is tried at each place of a name.
        longest = max(map(len, glob.split("*")[1:]), default=0)
        self._left -= times * (_STEPS_OF_GLOB + self._count * _STEPS_OF_NAME + self._characters * longest)
        if self._left < 0:
            raise TooManyComparisons
