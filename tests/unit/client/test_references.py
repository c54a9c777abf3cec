"""Resolving a name to exactly one object."""

from typing import NamedTuple

import pytest

from kleinkram.client._resources import is_glob, resolve_one
from kleinkram.contract.errors import AmbiguousName, NotFound


class Row(NamedTuple):
    name: str
    place: str


def row(ref: str, *rows: Row) -> Row:
    return resolve_one("mission", ref, rows, name=lambda row: row.name, label=lambda row: f"{row.place}/{row.name}")


def test_letter_case_and_unicode_form_do_not_matter() -> None:
    assert row("ZÜRICH", Row("Zu\u0308rich", "a")).place == "a"


def test_only_the_complete_name_matches() -> None:
    with pytest.raises(NotFound, match="'day'"):
        row("day", Row("day 1", "a"))


def test_several_matches_are_listed() -> None:
    with pytest.raises(AmbiguousName) as caught:
        row("day", Row("day", "a"), Row("Day", "b"))
    assert caught.value.candidates == ["a/day", "b/Day"]


def test_a_glob_may_match_only_one() -> None:
    assert row("d*", Row("day", "a")).name == "day"
    with pytest.raises(AmbiguousName):
        row("d*", Row("day", "a"), Row("dusk", "a"))
    assert is_glob("d?y")
    assert not is_glob("day")


def test_a_name_that_looks_like_a_glob_matches_itself_first() -> None:
    assert row("a*", Row("a*", "x"), Row("ab", "x")).name == "a*"
