"""The query language: a search as one text, the same in the CLI, the SDK, the server and the web.

`parse` returns the `FileFilter` of a text, `render` the normalized text of a filter.
"""

import datetime
import difflib
import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

from pydantic import ValidationError

from kleinkram.contract import units
from kleinkram.contract.checks import Verdict
from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import BlobState, ContentState, FileFilter
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.names import is_id
from kleinkram.contract.problems import first_message
from kleinkram.contract.search import FileQuery

# Names of metrics may contain `-`.
_KEY = re.compile(r"(?P<key>metric\.[A-Za-z0-9_.-]*|[A-Za-z][A-Za-z0-9_.]*)(?P<operator><=|>=|!=|[:=<>~])")
_PHRASE = re.compile(r'"(?P<inner>(?:[^"\\]|\\.)*)"(?=\s|$)|\S+', re.DOTALL)
_ESCAPED = re.compile(r"\\(.)", re.DOTALL)


@dataclass(frozen=True)
class Word:
    """One word of a query. `key` is empty for a search word; `column` counts from 1; `written` is the original text."""

    written: str
    column: int
    is_negative: bool
    key: str
    operator: str
    value: str
    is_quoted: bool

    def error(self, reason: str) -> InvalidQuery:
        """Return the error about this word."""
        return InvalidQuery(expression=self.written, reason=f"{reason} (column {self.column})", column=self.column)


def split(text: str) -> Iterator[Word]:
    """Yield the words of a query. Raises InvalidQuery."""
    at = 0
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        start, is_negative = at, text[at] == "-" and at + 1 < len(text) and not text[at + 1].isspace()
        key = _KEY.match(text, start + is_negative)
        at = key.end() if key else start + is_negative
        is_quoted = at < len(text) and text[at] == '"'
        value, at = _read_quoted(text, at) if is_quoted else _read_bare(text, at)
        name, operator = (key["key"], key["operator"]) if key else ("", "")
        yield Word(text[start:at], start + 1, is_negative, name, operator, value, is_quoted)


def read_term(text: str) -> Word:
    """Return the word of an excluded term, as in a filter's `without`. Raises InvalidQuery."""
    words = [*split(text)]
    if len(words) != 1 or words[0].is_negative:
        raise InvalidQuery(expression=text, reason="an excluded term is a single term, such as label:night")
    return words[0]


def phrases(text: str) -> list[str]:
    """Return the words and quoted phrases of the `text` of a filter, all of which must match."""
    matches = _PHRASE.finditer(text)
    words = [match[0] if match["inner"] is None else _unescaped(match["inner"]) for match in matches]
    return [word for word in words if word]


def _join_phrases(words: list[str]) -> str:
    """Return the `text` of a filter from which `phrases` reads these words."""
    return " ".join(word if _is_plain(word) else _quote(word) for word in words)


def _quote(value: str) -> str:
    """Return a value in quotes."""
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _escape(value: str, *, after: str) -> str:
    """Return a value to write after an operator, without quotes, which would make it text."""
    safe = "".join(f"\\{character}" if character.isspace() or character == "\\" else character for character in value)
    reads_otherwise = safe.startswith('"') or (safe.startswith("=") and after in {"<", ">"})
    return f"\\{safe}" if reads_otherwise else safe


def as_value(value: str) -> str:
    """Return a value to write after a key, in quotes if necessary."""
    return value if _is_plain(value) else _quote(value)


def _as_word(word: str) -> str:
    """Return a search word for a query, in quotes if it would mean something else without."""
    reads_otherwise = _KEY.match(word) is not None or (word.startswith("-") and word != "-")
    return _quote(word) if reads_otherwise else as_value(word)


def _is_plain(value: str) -> bool:
    return bool(value) and not any(character.isspace() or character in '"\\' for character in value)


def _read_bare(text: str, start: int) -> tuple[str, int]:
    end = start
    while end < len(text) and not text[end].isspace():
        end += 2 if text[end] == "\\" else 1
    end = min(end, len(text))
    return _unescaped(text[start:end]), end


def _read_quoted(text: str, start: int) -> tuple[str, int]:
    end = start + 1
    while end < len(text) and text[end] != '"':
        end += 2 if text[end] == "\\" else 1
    column = start + 1
    if end >= len(text):
        reason = f"the quote that opens at column {column} is not closed"
        raise InvalidQuery(expression=text[start:], reason=reason, column=column)
    if end + 1 < len(text) and not text[end + 1].isspace():
        reason = f'a space is missing after the quote that closes at column {end + 1}; write \\" for a quote inside'
        raise InvalidQuery(expression=text[start:], reason=reason, column=end + 1)
    return _unescaped(text[start + 1 : end]), end + 1


def _unescaped(text: str) -> str:
    return _ESCAPED.sub(r"\1", text)


META = "meta."
METRIC = "metric."
METRIC_EXPRESSION = re.compile(
    r"(?P<name>[a-z][a-z0-9_.-]{0,63})\s*(?P<operator><=|>=|!=|=|<|>)\s*"
    r"(?P<value>[-+]?(\d{1,300}(\.\d{0,300})?|\.\d{1,300})([eE][-+]?\d{1,2})?)",
    re.ASCII,
)
"""A comparison of a metric of runs with a number."""
_SAME = (":", "=")
_COMPARED = (">", ">=", "<", "<=", *_SAME)


@dataclass(frozen=True)
class QueryKey:
    """A key of the query language and its field of `FileFilter`; `id_field` is used if the value is an id.

    `several_field` has the names, globs and ids if the key occurs several times. `is_list`: any of several values
    suffices. `check` returns the value for the filter.
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


def _enum_check(kind: type[BlobState] | type[ContentState] | type[Verdict]) -> Callable[[str], str]:
    """Return a function that checks for a value of an enumeration, ignoring case."""
    words = [member.value for member in kind]

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
    QueryKey("content", "content", "content:broken", is_list=True, check=_enum_check(ContentState)),
    QueryKey("problem", "problem", "problem:long-gap", is_list=True),
    QueryKey("state", "state", "state:verified", is_list=True, check=_enum_check(BlobState)),
    QueryKey("month", "month", "month:2026-05", is_list=True, check=units.read_month),
    QueryKey("size", "size_bytes", "size>1GB", _COMPARED),
    QueryKey("duration", "duration_ns", "duration>10m", _COMPARED),
    QueryKey("after", "recorded_after", "after:2026-05-01"),
    QueryKey("before", "recorded_before", "before:2026-05-01"),
    QueryKey("event", "event", "event:stumble", is_list=True),
    QueryKey("verdict", "verdict", "verdict:bad", is_list=True, check=_enum_check(Verdict)),
    QueryKey("check", "check", "check:image.black", is_list=True),
    QueryKey("finding", "finding", "finding:clock.*", is_list=True),
)
KEYS: Mapping[str, QueryKey] = {key.name: key for key in _KEYS}


def is_glob(value: str) -> bool:
    """Return whether a value has wildcards."""
    return "*" in value or "?" in value


def _unknown_key(key: str) -> str:
    """Return the message for an unknown key: a similar one, and all that exist."""
    close = difflib.get_close_matches(key.lower()[:40], KEYS, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"there is no key {key!r}; {hint}the keys are {', '.join(KEYS)}, {META}FIELD and {METRIC}NAME"


_NAMES = [*KEYS]
# Metadata comes between the keys of recordings and those of files.
_PARTS = ("text", *_NAMES[: _NAMES.index("label")], META, *_NAMES[_NAMES.index("label") :], METRIC, "without")
_UNITS: Mapping[str, Mapping[str, int]] = {"size": units.SIZES, "duration": units.DURATIONS}


def render(matching: FileFilter) -> str:
    """Return the text of a filter: words first, then keys, then excluded terms.

    Raises InvalidQuery.
    """
    return join_terms(terms(matching))


def terms(matching: FileFilter) -> dict[str, list[str]]:
    """Return the terms of a filter by part, in order: `text`, each key, `meta.` and `without`.

    Raises InvalidQuery.
    """
    return {part: terms_of(part, matching) for part in _PARTS}


def join_terms(by_part: Mapping[str, list[str]]) -> str:
    """Join the terms of all parts to a text."""
    return " ".join(itertools.chain.from_iterable(by_part.values()))


def terms_of(part: str, matching: FileFilter) -> list[str]:
    """Return the terms of one part of a filter, independent of its other parts.

    Raises InvalidQuery.
    """
    if part == "text":
        return [_as_word(word) for word in phrases(matching.text or "")]
    if part == META:
        return [_render_where(expression) for expression in matching.where]
    if part == METRIC:
        return [_render_metric(expression) for expression in matching.metric]
    if part == "without":
        return [f"-{read_term(term).written}" for term in matching.without]
    return [*_terms_of(KEYS[part], matching)]


def _render_where(expression: str) -> str:
    """Return the term for a comparison with metadata. Raises InvalidQuery."""
    match = WHERE_EXPRESSION.fullmatch(expression.strip())
    if match is None:
        raise InvalidQuery(expression=expression, reason="it is not a comparison; write it like robot=anymal")
    operator, value = match["operator"], match["value"].strip()
    is_text = len(value) > 1 and value.startswith('"') and value.endswith('"')
    if operator == "~":
        written = as_value(value)
    elif is_text or (operator == "=" and is_glob(value)):
        written = _quote(value[1:-1] if is_text else value)
    else:
        written = _escape(value, after=operator)
    return f"{META}{match['field']}{':' if operator == '=' else operator}{written}"


def _render_metric(expression: str) -> str:
    """Return the term for a comparison with a metric. Raises InvalidQuery."""
    match = METRIC_EXPRESSION.fullmatch(expression.strip())
    if match is None:
        reason = "it is not a comparison of a metric with a number; write it like ate_rmse>0.5"
        raise InvalidQuery(expression=expression, reason=reason)
    operator = ":" if match["operator"] == "=" else match["operator"]
    return f"{METRIC}{match['name']}{operator}{match['value']}"


def _terms_of(key: QueryKey, matching: FileFilter) -> Iterator[str]:
    if unit_sizes := _UNITS.get(key.name):
        minimum, maximum = (getattr(matching, f"{end}_{key.field}") for end in ("min", "max"))
        bounds_by_operator = (
            {":": minimum} if minimum is not None and minimum == maximum else {">=": minimum, "<=": maximum}
        )
        for operator, bound in bounds_by_operator.items():
            if bound is not None:
                yield f"{key.name}{units.format_bound(operator, bound, unit_sizes)}"
        return
    for field in dict.fromkeys((key.id_field or key.field, key.field, key.several_field or key.field)):
        value = getattr(matching, field)
        if key.name in {"after", "before"} and value is not None:
            value = units.format_time(value)
        for item in value if isinstance(value, list) else [] if value is None else [value]:
            yield f"{key.name}:{as_value(str(getattr(item, 'value', item)))}"


_AMOUNTS: dict[str, Callable[[str], Fraction]] = {"size": units.read_size, "duration": units.read_duration}
_TIGHTEST: dict[str, Callable[[datetime.datetime, datetime.datetime], datetime.datetime]] = {
    "after": max,
    "before": min,
}


def parse(text: str) -> FileFilter:
    """Return the filter of a query; an empty text matches everything. Raises InvalidQuery."""
    reader = _QueryReader()
    for word in split(text):
        reader.add(word)
    return reader.filter()


def parse_term(text: str) -> FileFilter:
    """Return the filter of one term, as in a filter's `without`. Raises InvalidQuery."""
    reader = _QueryReader()
    reader.add(read_term(text))
    return reader.filter()


class _QueryReader:
    """Builds a filter from words; remembers the first word that set each field, for errors."""

    def __init__(self) -> None:
        self._values: dict[str, str] = {}
        self._numbers: dict[str, int] = {}
        self._times: dict[str, datetime.datetime] = {}
        self._lists: dict[str, list[str]] = {}
        self._words: list[str] = []
        self._words_by_field: dict[str, Word] = {}

    def add(self, word: Word) -> None:
        """Add one word."""
        if word.is_negative:
            term = _QueryReader()
            term.add(replace(word, is_negative=False))
            if rendered := render(term.filter()):
                self._add_value("without", rendered, word)
        elif not word.key:
            self._words += [word.value] if word.value else []
            self._words_by_field.setdefault("text", word)
        elif word.key.startswith(META) and word.key != META:
            self._add_value("where", _comparison(word), word)
        elif word.key.startswith(METRIC) and word.key != METRIC:
            self._add_value("metric", _metric_comparison(word), word)
        elif word.key not in KEYS:
            hint = f"write metadata as {META}{word.key}{word.operator}{as_value(word.value)}, and text in quotes"
            raise word.error(f"{_unknown_key(word.key)}; {hint}")
        else:
            self._add_key(KEYS[word.key], word)

    def filter(self) -> FileFilter:
        """Return the filter. Raises InvalidQuery."""
        values: dict[str, object] = {**self._values, **self._numbers, **self._times, **self._lists}
        for key in KEYS.values():
            several = self._lists.get(key.several_field or "", [])
            fields = {str(key.id_field) if is_id(value) else key.field: value for value in several}
            if several and len(fields) == len(several):  # one name and one id: both must match
                del values[str(key.several_field)]
                values |= fields
                self._words_by_field |= dict.fromkeys(fields, self._words_by_field[str(key.several_field)])
        if self._words:
            values["text"] = _join_phrases(self._words)
        try:
            return FileFilter.model_validate(values)
        except ValidationError as error:
            word = self._words_by_field[str(error.errors()[0]["loc"][0])]
            raise word.error(first_message(error)) from None

    def _add_key(self, key: QueryKey, word: Word) -> None:
        if word.operator not in key.operators:
            raise word.error(f"{key.name} does not support {word.operator}; write it like {key.example}")
        if not word.value and not word.is_quoted:
            raise word.error(f"it has no value; write it like {key.example}")
        try:
            if key.name in _AMOUNTS:
                minimum, maximum = units.bounds(word.operator, _AMOUNTS[key.name](word.value))
                for field, number, tighter in ((f"min_{key.field}", minimum, max), (f"max_{key.field}", maximum, min)):
                    if number is not None:
                        self._numbers[field] = tighter(self._numbers.get(field, number), number)
                        self._words_by_field.setdefault(field, word)
            elif key.name in _TIGHTEST:
                at = units.read_time(word.value)
                self._times[key.field] = _TIGHTEST[key.name](self._times.get(key.field, at), at)
            elif key.is_list:
                self._add_value(key.field, key.check(word.value), word)
            else:
                self._set_value(key, word)
        except ValueError as error:
            raise word.error(str(error)) from None

    def _set_value(self, key: QueryKey, word: Word) -> None:
        by_id = key.id_field is not None and is_id(word.value)
        if key.only_id and not by_id:
            raise word.error(f"write it like {key.example}")
        field = str(key.id_field) if by_id else key.field
        if key.several_field is not None:
            self._add_value(key.several_field, word.value, word)
            return
        if field in self._values:
            raise word.error(f"{key.name} is already set at column {self._words_by_field[field].column}")
        self._values[field] = word.value
        self._words_by_field[field] = word

    def _add_value(self, field: str, value: str, word: Word) -> None:
        values = self._lists.setdefault(field, [])
        if value not in values:
            values.append(value)
        self._words_by_field.setdefault(field, word)


def _comparison(word: Word) -> str:
    """Return a comparison with metadata for a filter's `where`; a value in quotes is text."""
    field = word.key.removeprefix(META)
    if "" in field.split("."):
        raise word.error(f"the field has an empty part; write it like {META}site.latitude>47")
    operator = "=" if word.operator == ":" else word.operator
    if operator == "=" and not word.is_quoted and is_glob(word.value):
        operator = "~"
    value = f'"{word.value}"' if word.is_quoted and operator != "~" else word.value
    space = " " if value.startswith("=") else ""
    expression = f"{field}{operator}{space}{value}"
    if WHERE_EXPRESSION.fullmatch(expression) is None:
        raise word.error(f"it has no value, or more than one line; write it like {META}{field}:VALUE")
    return expression


def _metric_comparison(word: Word) -> str:
    """Return a comparison with a metric for a filter's `metric`."""
    expression = f"{word.key.removeprefix(METRIC)}{'=' if word.operator == ':' else word.operator}{word.value}"
    if METRIC_EXPRESSION.fullmatch(expression) is None:
        raise word.error(f"a metric is compared with a number; write it like {METRIC}ate_rmse>0.5")
    return expression


def combined_filter(file_query: FileQuery) -> FileFilter:
    """Return the filter that a filter and the text of a query mean together. Raises InvalidQuery."""
    plain = FileFilter.model_construct(**{name: getattr(file_query, name) for name in FileFilter.model_fields})
    if file_query.query is None:
        return plain
    in_query = parse(file_query.query)
    for key in KEYS.values():
        # Several values in one text mean any of them; one in the text and one outside cannot both apply.
        fields = [field for field in (key.field, key.id_field, key.several_field) if key.several_field and field]
        if any(getattr(in_query, field) for field in fields) and any(getattr(plain, field) for field in fields):
            words = (word for word in split(file_query.query) if word.key == key.name and not word.is_negative)
            word = next(words)
            raise word.error(f"{key.name} is already set at column {word.column}")
    return parse(f"{file_query.query} {render(plain)}".strip())
