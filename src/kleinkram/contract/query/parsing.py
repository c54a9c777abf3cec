"""From the text of a query to the filter that it means."""

import datetime
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

from pydantic import ValidationError

from kleinkram.contract.amounts import bounds, read_duration, read_size, read_time
from kleinkram.contract.files import FileFilter
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.names import is_id
from kleinkram.contract.query.keys import KEYS, META, Key, is_glob, possible
from kleinkram.contract.query.rendering import render
from kleinkram.contract.query.words import Word, as_value, joined, single, split
from kleinkram.contract.searching import FileQuery
from kleinkram.contract.wording import in_plain_words

_AMOUNTS: dict[str, Callable[[str], Fraction]] = {"size": read_size, "duration": read_duration}
_TIGHTEST: dict[str, Callable[[datetime.datetime, datetime.datetime], datetime.datetime]] = {
    "after": max,
    "before": min,
}


def parse(text: str) -> FileFilter:
    """Return the filter that a query means; an empty text means everything.

    Raises:
        InvalidQuery: it cannot be read; says which word, at which column, and what is possible.
    """
    reading = _Reading()
    for word in split(text):
        reading.take(word)
    return reading.filter()


def parse_term(text: str) -> FileFilter:
    """Return the filter that one term means, such as those of a filter's `without`.

    Raises:
        InvalidQuery: it cannot be read, is negative itself, or is not just one.
    """
    reading = _Reading()
    reading.take(single(text))
    return reading.filter()


class _Reading:
    """What was read so far, and the word by which each field was said first."""

    def __init__(self) -> None:
        self._values: dict[str, str] = {}
        self._numbers: dict[str, int] = {}
        self._times: dict[str, datetime.datetime] = {}
        self._lists: dict[str, list[str]] = {}
        self._words: list[str] = []
        self._said_by: dict[str, Word] = {}

    def take(self, word: Word) -> None:
        """Read one word more."""
        if word.is_negative:
            self._leave_out(word)
        elif not word.key:
            self._words += [word.value] if word.value else []
            self._said_by.setdefault("text", word)
        elif word.key.startswith(META) and word.key != META:
            self._add("where", _comparison(word), word)
        elif word.key not in KEYS:
            raise word.wrong(_unknown(word))
        else:
            self._take_key(KEYS[word.key], word)

    def filter(self) -> FileFilter:
        """Return the filter of all that was read.

        Raises:
            InvalidQuery: there is too much of something.
        """
        given: dict[str, object] = {**self._values, **self._numbers, **self._times, **self._lists}
        for key in KEYS.values():
            values = self._lists.get(key.several_field or "", [])
            named = {str(key.id_field) if is_id(value) else key.field: value for value in values}
            if values and len(named) == len(values):  # one name beside one id: both must hold
                del given[str(key.several_field)]
                given |= named
                self._said_by |= dict.fromkeys(named, self._said_by[str(key.several_field)])
        if self._words:
            given["text"] = joined(self._words)
        try:
            return FileFilter.model_validate(given)
        except ValidationError as error:
            word = self._said_by[str(error.errors()[0]["loc"][0])]
            raise word.wrong(in_plain_words(error)) from None

    def _leave_out(self, word: Word) -> None:
        term = _Reading()
        term.take(replace(word, is_negative=False))
        if said := render(term.filter()):
            self._add("without", said, word)

    def _take_key(self, key: Key, word: Word) -> None:
        if word.operator not in key.operators:
            raise word.wrong(f"{key.name} is not compared by {word.operator}; write it like {key.example}")
        if not word.value and not word.is_quoted:
            raise word.wrong(f"nothing stands behind it; write it like {key.example}")
        try:
            if key.name in _AMOUNTS:
                self._bound(key, word, *bounds(word.operator, _AMOUNTS[key.name](word.value)))
            elif key.name in _TIGHTEST:
                self._tighten(key, word)
            elif key.is_list:
                self._add(key.field, key.check(word.value), word)
            else:
                self._set(key, word)
        except ValueError as error:
            raise word.wrong(str(error)) from None

    def _set(self, key: Key, word: Word) -> None:
        by_id = key.id_field is not None and is_id(word.value)
        if key.only_id and not by_id:
            raise word.wrong(f"write it like {key.example}")
        field = str(key.id_field) if by_id else key.field
        if key.several_field is not None:
            self._add(key.several_field, word.value, word)
            return
        if field in self._values:
            raise word.wrong(f"{key.name} was said at column {self._said_by[field].column} already")
        self._values[field] = word.value
        self._said_by[field] = word

    def _bound(self, key: Key, word: Word, least: int | None, most: int | None) -> None:
        for field, number, tighter in ((f"min_{key.field}", least, max), (f"max_{key.field}", most, min)):
            if number is not None:
                self._numbers[field] = tighter(self._numbers.get(field, number), number)
                self._said_by.setdefault(field, word)

    def _tighten(self, key: Key, word: Word) -> None:
        at = read_time(word.value)
        self._times[key.field] = _TIGHTEST[key.name](self._times.get(key.field, at), at)

    def _add(self, field: str, value: str, word: Word) -> None:
        held = self._lists.setdefault(field, [])
        if value not in held:
            held.append(value)
        self._said_by.setdefault(field, word)


def _comparison(word: Word) -> str:
    """Return a comparison with metadata as a filter's `where` holds it: what is in quotes is text, whatever it says."""
    field = word.key.removeprefix(META)
    if "" in field.split("."):
        raise word.wrong(f"the field has an empty part; write it like {META}site.latitude>47")
    operator = "=" if word.operator == ":" else word.operator
    if operator == "=" and not word.is_quoted and is_glob(word.value):
        operator = "~"
    value = f'"{word.value}"' if word.is_quoted and operator != "~" else word.value
    space = " " if value.startswith("=") else ""
    expression = f"{field}{operator}{space}{value}"
    if WHERE_EXPRESSION.fullmatch(expression) is None:
        raise word.wrong(f"nothing stands behind it, or more than one line; write it like {META}{field}:VALUE")
    return expression


def _unknown(word: Word) -> str:
    told = f"metadata is asked for by {META}{word.key}{word.operator}{as_value(word.value)}, and text in quotes"
    return f"{possible(word.key)}; {told}"


def whole(asked: FileQuery) -> FileFilter:
    """Return the one filter that a filter and the text beside it mean together, as if said in one text.

    Raises:
        InvalidQuery: the text cannot be read, or says again what may be said once.
    """
    plain = FileFilter.model_construct(**{name: getattr(asked, name) for name in FileFilter.model_fields})
    if asked.query is None:
        return plain
    in_query = parse(asked.query)
    for key in KEYS.values():
        # Several in one text mean any of them; one in the text and one beside it cannot both hold.
        fields = [field for field in (key.field, key.id_field, key.several_field) if key.several_field and field]
        if any(getattr(in_query, field) for field in fields) and any(getattr(plain, field) for field in fields):
            word = next(each for each in split(asked.query) if each.key == key.name and not each.is_negative)
            raise word.wrong(f"{key.name} was said at column {word.column} already")
    return parse(f"{asked.query} {render(plain)}".strip())
