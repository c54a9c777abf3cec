"""The query language: one text for a whole search, the same in the CLI, the SDK, the server and the web.

`parse` makes a `FileFilter` of a text and `render` makes the text of a filter, in one order and spelling. Pure.
"""

import datetime
import difflib
import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

from pydantic import ValidationError

from kleinkram.contract.amounts import (
    DURATIONS,
    SIZES,
    bounds,
    format_bound,
    format_time,
    read_duration,
    read_month,
    read_size,
    read_time,
)
from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import BlobState, ContentState, FileFilter
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.names import is_id
from kleinkram.contract.problems import in_plain_words
from kleinkram.contract.search import FileQuery

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
    """Yield the words of a query. Raises InvalidQuery."""
    at = 0
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        word, at = _word(text, at)
        yield word


def single(text: str) -> Word:
    """Return the one word of a term that is left out, as a filter's `without` holds it. Raises InvalidQuery."""
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


META = "meta."
_SAME = (":", "=")
_COMPARED = (">", ">=", "<", "<=", *_SAME)


@dataclass(frozen=True)
class QueryKey:
    """A key. `field` is that of `FileFilter`; `id_field` takes its place where the value is an id.

    `several_field` holds the names, globs and ids of a key that is said several times.
    `is_list`: it may be said several times, and any of these is enough. `check` returns a value as it is kept.
    """

    name: str
    field: str
    example: str
    operators: tuple[str, ...] = _SAME
    is_list: bool = False
    id_field: str | None = None
    several_field: str | None = None
    only_id: bool = False
    check: Callable[[str], str] = str


def one_of(kind: type[BlobState] | type[ContentState]) -> Callable[[str], str]:
    """Return what lets the words of an enumeration through, in any case."""
    words = [each.value for each in kind]

    def check(value: str) -> str:
        if value.lower() not in words:
            raise ValueError(f"it is one of {', '.join(words)}")
        return value.lower()

    return check


_KEYS = (
    QueryKey("project", "project", "project:NAME", id_field="project_id", several_field="projects"),
    QueryKey("mission", "mission", "mission:NAME", id_field="mission_id", several_field="missions"),
    QueryKey("recording", "recording_id", "recording:ID", id_field="recording_id", only_id=True),
    QueryKey("path", "path", "path:*.mcap", is_list=True),
    QueryKey("topic", "topic", "topic:/imu/*", is_list=True),
    QueryKey("type", "message_type", "type:*/Image", is_list=True),
    QueryKey("label", "label", "label:LABEL", is_list=True),
    QueryKey("format", "format", "format:mcap", is_list=True),
    QueryKey("content", "content", "content:broken", is_list=True, check=one_of(ContentState)),
    QueryKey("problem", "problem", "problem:long-gap", is_list=True),
    QueryKey("state", "state", "state:verified", is_list=True, check=one_of(BlobState)),
    QueryKey("month", "month", "month:2026-05", is_list=True, check=read_month),
    QueryKey("size", "size_bytes", "size>1GB", _COMPARED),
    QueryKey("duration", "duration_ns", "duration>10m", _COMPARED),
    QueryKey("after", "recorded_after", "after:2026-05-01"),
    QueryKey("before", "recorded_before", "before:2026-05-01"),
)
KEYS: Mapping[str, QueryKey] = {key.name: key for key in _KEYS}


def is_glob(value: str) -> bool:
    """Say whether a value may stand for several."""
    return "*" in value or "?" in value


def possible(given: str) -> str:
    """Return what is said of a key that there is none of: what may have been meant, and what there is."""
    close = difflib.get_close_matches(given.lower()[:40], KEYS, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"there is no key {given!r}; {hint}There are {', '.join(KEYS)} and {META}FIELD"


_NAMES = [*KEYS]
# Metadata stands between what is said of the recording and of the file.
_PARTS = ("text", *_NAMES[: _NAMES.index("label")], META, *_NAMES[_NAMES.index("label") :], "without")
_UNITS: Mapping[str, Mapping[str, int]] = {"size": SIZES, "duration": DURATIONS}


def render(matching: FileFilter) -> str:
    """Return the text of a filter: words first, then what it says by keys, then what is left out.

    Raises InvalidQuery.
    """
    return in_words(terms(matching))


def terms(matching: FileFilter) -> dict[str, list[str]]:
    """Return the terms of a filter by what they say: `text`, each key, `meta.` and `without`; in their order.

    Raises InvalidQuery.
    """
    return {part: terms_of(part, matching) for part in _PARTS}


def in_words(by_part: Mapping[str, list[str]]) -> str:
    """Return the text that terms by part say."""
    return " ".join(itertools.chain.from_iterable(by_part.values()))


def terms_of(part: str, matching: FileFilter) -> list[str]:
    """Return the terms of one part of a filter; those of a key do not depend on anything else that the filter says.

    Raises InvalidQuery.
    """
    if part == "text":
        return [as_word(word) for word in phrases(matching.text or "")]
    if part == META:
        return [render_where(expression) for expression in matching.where]
    if part == "without":
        return [f"-{single(term).written}" for term in matching.without]
    return [*_terms_of(KEYS[part], matching)]


def render_where(expression: str) -> str:
    """Return the term that says a comparison with metadata. Raises InvalidQuery."""
    found = WHERE_EXPRESSION.fullmatch(expression.strip())
    if found is None:
        raise InvalidQuery(expression=expression, reason="it is not a comparison; write it like robot=anymal")
    operator, value = found["operator"], found["value"].strip()
    is_text = len(value) > 1 and value.startswith('"') and value.endswith('"')
    if operator == "~":
        said = as_value(value)
    elif is_text or (operator == "=" and is_glob(value)):
        said = quoted(value[1:-1] if is_text else value)
    else:
        said = escaped(value, after=operator)
    return f"{META}{found['field']}{':' if operator == '=' else operator}{said}"


def _terms_of(key: QueryKey, matching: FileFilter) -> Iterator[str]:
    if key.name in _UNITS:
        yield from _bounds(key, matching)
        return
    fields = (key.id_field or key.field, key.field, key.several_field or key.field)
    for field in dict.fromkeys(fields):
        held = getattr(matching, field)
        if key.name in {"after", "before"}:
            held = None if held is None else format_time(held)
        values = held if isinstance(held, list) else [] if held is None else [held]
        yield from (f"{key.name}:{as_value(str(getattr(value, 'value', value)))}" for value in values)


def _bounds(key: QueryKey, matching: FileFilter) -> Iterator[str]:
    units = _UNITS[key.name]
    least, most = (getattr(matching, f"{end}_{key.field}") for end in ("min", "max"))
    if least is not None and least == most:
        yield f"{key.name}{format_bound(':', least, units)}"
        return
    if least is not None:
        yield f"{key.name}{format_bound('>=', least, units)}"
    if most is not None:
        yield f"{key.name}{format_bound('<=', most, units)}"


_AMOUNTS: dict[str, Callable[[str], Fraction]] = {"size": read_size, "duration": read_duration}
_TIGHTEST: dict[str, Callable[[datetime.datetime, datetime.datetime], datetime.datetime]] = {
    "after": max,
    "before": min,
}


def parse(text: str) -> FileFilter:
    """Return the filter that a query means; an empty text means everything. Raises InvalidQuery."""
    reader = _QueryReader()
    for word in split(text):
        reader.take(word)
    return reader.filter()


def parse_term(text: str) -> FileFilter:
    """Return the filter that one term means, such as those of a filter's `without`. Raises InvalidQuery."""
    reader = _QueryReader()
    reader.take(single(text))
    return reader.filter()


class _QueryReader:
    """What was read so far, and the word by which each field was said first."""

    def __init__(self) -> None:
        self._values: dict[str, str] = {}
        self._numbers: dict[str, int] = {}
        self._times: dict[str, datetime.datetime] = {}
        self._lists: dict[str, list[str]] = {}
        self._words: list[str] = []
        self._words_by_field: dict[str, Word] = {}

    def take(self, word: Word) -> None:
        """Read one word more."""
        if word.is_negative:
            self._leave_out(word)
        elif not word.key:
            self._words += [word.value] if word.value else []
            self._words_by_field.setdefault("text", word)
        elif word.key.startswith(META) and word.key != META:
            self._add("where", _comparison(word), word)
        elif word.key not in KEYS:
            raise word.wrong(_unknown(word))
        else:
            self._take_key(KEYS[word.key], word)

    def filter(self) -> FileFilter:
        """Return the filter of all that was read. Raises InvalidQuery."""
        given: dict[str, object] = {**self._values, **self._numbers, **self._times, **self._lists}
        for key in KEYS.values():
            values = self._lists.get(key.several_field or "", [])
            named = {str(key.id_field) if is_id(value) else key.field: value for value in values}
            if values and len(named) == len(values):  # one name beside one id: both must hold
                del given[str(key.several_field)]
                given |= named
                self._words_by_field |= dict.fromkeys(named, self._words_by_field[str(key.several_field)])
        if self._words:
            given["text"] = joined(self._words)
        try:
            return FileFilter.model_validate(given)
        except ValidationError as error:
            word = self._words_by_field[str(error.errors()[0]["loc"][0])]
            raise word.wrong(in_plain_words(error)) from None

    def _leave_out(self, word: Word) -> None:
        term = _QueryReader()
        term.take(replace(word, is_negative=False))
        if said := render(term.filter()):
            self._add("without", said, word)

    def _take_key(self, key: QueryKey, word: Word) -> None:
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

    def _set(self, key: QueryKey, word: Word) -> None:
        by_id = key.id_field is not None and is_id(word.value)
        if key.only_id and not by_id:
            raise word.wrong(f"write it like {key.example}")
        field = str(key.id_field) if by_id else key.field
        if key.several_field is not None:
            self._add(key.several_field, word.value, word)
            return
        if field in self._values:
            raise word.wrong(f"{key.name} was said at column {self._words_by_field[field].column} already")
        self._values[field] = word.value
        self._words_by_field[field] = word

    def _bound(self, key: QueryKey, word: Word, least: int | None, most: int | None) -> None:
        for field, number, tighter in ((f"min_{key.field}", least, max), (f"max_{key.field}", most, min)):
            if number is not None:
                self._numbers[field] = tighter(self._numbers.get(field, number), number)
                self._words_by_field.setdefault(field, word)

    def _tighten(self, key: QueryKey, word: Word) -> None:
        at = read_time(word.value)
        self._times[key.field] = _TIGHTEST[key.name](self._times.get(key.field, at), at)

    def _add(self, field: str, value: str, word: Word) -> None:
        held = self._lists.setdefault(field, [])
        if value not in held:
            held.append(value)
        self._words_by_field.setdefault(field, word)


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

    Raises InvalidQuery.
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
