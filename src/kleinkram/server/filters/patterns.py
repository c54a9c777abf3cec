"""From what a person types (globs, words) to conditions on a column. Every value is a bound parameter."""

from collections.abc import Sequence

from sqlalchemy import ColumnElement, false, or_

from kleinkram.contract.names import name_key

ESCAPE = "\\"


def like_pattern(glob: str) -> str:
    """Return the LIKE pattern of a glob: `*` is any run of characters, `?` is one, all else is itself."""
    return _escaped(glob).replace("*", "%").replace("?", "_")


def containing(text: str) -> str:
    """Return the LIKE pattern of whatever contains `text`."""
    return f"%{_escaped(text)}%"


def _escaped(text: str) -> str:
    for special in (ESCAPE, "%", "_"):
        text = text.replace(special, ESCAPE + special)
    return text


def matches(column: ColumnElement[str], glob: str) -> ColumnElement[bool]:
    """Return the condition that a column matches a glob, letter case included; without a wildcard, equals it."""
    if "*" in glob or "?" in glob:
        return column.like(like_pattern(glob), escape=ESCAPE)
    return column == glob


def matches_key(column: ColumnElement[str], glob: str) -> ColumnElement[bool]:
    """Return the condition that a column of name keys matches a glob, in any case and Unicode form."""
    return matches(column, name_key(glob))


def matches_any(column: ColumnElement[str], globs: Sequence[str]) -> ColumnElement[bool]:
    """Return the condition that a column matches at least one glob, letter case included."""
    return or_(false(), *(matches(column, glob) for glob in globs))


def holds_word(column: ColumnElement[str], word: str) -> ColumnElement[bool]:
    """Return the condition that a text contains a word, in any case."""
    return column.ilike(containing(word), escape=ESCAPE)


def key_holds_word(column: ColumnElement[str], word: str) -> ColumnElement[bool]:
    """Return the condition that a column of name keys contains a word, in any case and Unicode form."""
    return column.like(containing(name_key(word)), escape=ESCAPE)
