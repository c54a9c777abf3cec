"""Splitting a query into words, with what each is: a word to be found, or a term with key and value.

Quotes hold a value together and a backslash takes the next character as it is; nothing here knows which keys there are.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from kleinkram.contract.errors import InvalidQuery

_KEY = re.compile(r"(?P<key>[A-Za-z][A-Za-z0-9_.]*)(?P<operator><=|>=|!=|[:=<>~])")
_PHRASE = re.compile(r'"(?P<inner>(?:[^"\\]|\\.)*)"(?=\s|$)|\S+', re.DOTALL)
_ESCAPED = re.compile(r"\\(.)", re.DOTALL)


@dataclass(frozen=True)
class Word:
    """One word of a query. `key` is empty for a word to be found; `column` counts from 1; `written` is as it stands."""

    written: str
    column: int
    is_negative: bool
    key: str
    operator: str
    value: str
    is_quoted: bool

    def wrong(self, reason: str) -> InvalidQuery:
        """Return the error that this word cannot be used."""
        return InvalidQuery(expression=self.written, reason=f"{reason} (column {self.column})", column=self.column)


def split(text: str) -> Iterator[Word]:
    """Yield the words of a query.

    Raises:
        InvalidQuery: a quote is not closed, or something follows it without a space.
    """
    at = 0
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        word, at = _word(text, at)
        yield word


def single(text: str) -> Word:
    """Return the one word of a term that is left out, as a filter's `without` holds it.

    Raises:
        InvalidQuery: it cannot be read, is negative itself, or is not just one.
    """
    words = [*split(text)]
    if len(words) != 1 or words[0].is_negative:
        raise InvalidQuery(expression=text, reason="what is left out is one term each, such as label:night")
    return words[0]


def phrases(text: str) -> list[str]:
    """Return the words of the `text` of a filter, each of which must be found; quotes make several words one."""
    found = [_unescaped(each["inner"]) if each["inner"] is not None else each[0] for each in _PHRASE.finditer(text)]
    return [phrase for phrase in found if phrase]


def joined(words: list[str]) -> str:
    """Return the `text` of a filter that `phrases` reads as these words."""
    return " ".join(word if _is_plain(word) else quoted(word) for word in words)


def quoted(value: str) -> str:
    """Return a value in quotes."""
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


def escaped(value: str, *, after: str) -> str:
    """Return a value as it stands behind an operator without quotes around it, which would say that it is text."""
    safe = "".join(f"\\{character}" if character.isspace() or character == "\\" else character for character in value)
    reads_otherwise = safe.startswith('"') or (safe.startswith("=") and after in {"<", ">"})
    return f"\\{safe}" if reads_otherwise else safe


def as_value(value: str) -> str:
    """Return how a value stands behind a key: in quotes where it must."""
    return value if _is_plain(value) else quoted(value)


def as_word(word: str) -> str:
    """Return how a word to be found stands in a query: in quotes where it would read as something else."""
    reads_otherwise = _KEY.match(word) is not None or (word.startswith("-") and word != "-")
    return quoted(word) if reads_otherwise else as_value(word)


def _is_plain(value: str) -> bool:
    return bool(value) and not any(character.isspace() or character in '"\\' for character in value)


def _word(text: str, start: int) -> tuple[Word, int]:
    is_negative = text[start] == "-" and start + 1 < len(text) and not text[start + 1].isspace()
    begin = start + is_negative
    key = _KEY.match(text, begin)
    at = key.end() if key else begin
    is_quoted = at < len(text) and text[at] == '"'
    value, end = _in_quotes(text, at) if is_quoted else _bare(text, at)
    written = text[start:end]
    name, operator = (key["key"], key["operator"]) if key else ("", "")
    return Word(written, start + 1, is_negative, name, operator, value, is_quoted), end


def _bare(text: str, start: int) -> tuple[str, int]:
    end = start
    while end < len(text) and not text[end].isspace():
        end += 2 if text[end] == "\\" else 1
    end = min(end, len(text))
    return _unescaped(text[start:end]), end


def _in_quotes(text: str, start: int) -> tuple[str, int]:
    end = start + 1
    while end < len(text) and text[end] != '"':
        end += 2 if text[end] == "\\" else 1
    column = start + 1
    if end >= len(text):
        reason = f"the quote that opens at column {column} is not closed"
        raise InvalidQuery(expression=text[start:], reason=reason, column=column)
    if end + 1 < len(text) and not text[end + 1].isspace():
        reason = f'a space is missing behind the quote that closes at column {end + 1}; write \\" for a quote inside'
        raise InvalidQuery(expression=text[start:], reason=reason, column=end + 1)
    return _unescaped(text[start + 1 : end]), end + 1


def _unescaped(text: str) -> str:
    return _ESCAPED.sub(r"\1", text)
