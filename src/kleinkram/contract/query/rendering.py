"""From a filter to the text that says it: one order and one spelling, which `parse` reads as the same filter."""

import itertools
from collections.abc import Iterator, Mapping

from kleinkram.contract.amounts import DURATIONS, SIZES, say_bound, say_time
from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import FileFilter
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.query.keys import KEYS, META, Key, is_glob
from kleinkram.contract.query.words import as_value, as_word, escaped, phrases, quoted, single

_KEYS = [*KEYS]
# Metadata stands between what is said of the recording and of the file.
_PARTS = ("text", *_KEYS[: _KEYS.index("label")], META, *_KEYS[_KEYS.index("label") :], "without")
_UNITS: Mapping[str, Mapping[str, int]] = {"size": SIZES, "duration": DURATIONS}


def render(matching: FileFilter) -> str:
    """Return the text of a filter: words first, then what it says by keys, then what is left out.

    Raises:
        InvalidQuery: a comparison in `where` is none, or what is left out is not one term.
    """
    return in_words(terms(matching))


def terms(matching: FileFilter) -> dict[str, list[str]]:
    """Return the terms of a filter by what they say: `text`, each key, `meta.` and `without`; in their order.

    Raises:
        InvalidQuery: as for `render`.
    """
    return {part: terms_of(part, matching) for part in _PARTS}


def in_words(by_part: Mapping[str, list[str]]) -> str:
    """Return the text that terms by part say."""
    return " ".join(itertools.chain.from_iterable(by_part.values()))


def terms_of(part: str, matching: FileFilter) -> list[str]:
    """Return the terms of one part of a filter; those of a key do not depend on anything else that the filter says.

    Raises:
        InvalidQuery: as for `render`.
    """
    if part == "text":
        return [as_word(word) for word in phrases(matching.text or "")]
    if part == META:
        return [render_where(expression) for expression in matching.where]
    if part == "without":
        return [f"-{single(term).written}" for term in matching.without]
    return [*_terms_of(KEYS[part], matching)]


def render_where(expression: str) -> str:
    """Return the term that says a comparison with metadata.

    Raises:
        InvalidQuery: it is none.
    """
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


def _terms_of(key: Key, matching: FileFilter) -> Iterator[str]:
    if key.name in _UNITS:
        yield from _bounds(key, matching)
        return
    fields = (key.id_field or key.field, key.field, key.several_field or key.field)
    for field in dict.fromkeys(fields):
        held = getattr(matching, field)
        if key.name in {"after", "before"}:
            held = None if held is None else say_time(held)
        values = held if isinstance(held, list) else [] if held is None else [held]
        yield from (f"{key.name}:{as_value(str(getattr(value, 'value', value)))}" for value in values)


def _bounds(key: Key, matching: FileFilter) -> Iterator[str]:
    units = _UNITS[key.name]
    least, most = (getattr(matching, f"{end}_{key.field}") for end in ("min", "max"))
    if least is not None and least == most:
        yield f"{key.name}{say_bound(':', least, units)}"
        return
    if least is not None:
        yield f"{key.name}{say_bound('>=', least, units)}"
    if most is not None:
        yield f"{key.name}{say_bound('<=', most, units)}"
