"""Comparisons with a mission's metadata, as people write them: `robot=anymal`, `temperature>20`, `site~zur*`.

A comparison holds only where the mission has the field, whatever the operator. Numbers compare as numbers, all else as
text by code point (so ISO dates compare as dates); a value in double quotes is text even if it looks like a number.
`=` and `!=` also look into lists. Every value is a bound parameter.
"""

import re
from collections.abc import Sequence

from sqlalchemy import ColumnElement, Text, and_, bindparam, case, func, not_, or_, type_coerce
from sqlalchemy.dialects.postgresql import ARRAY, JSONB

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.units import iso_text
from kleinkram.server.filters.patterns import like_pattern
from kleinkram.server.tables import mission

_NUMBER = re.compile(r"[-+]?(\d{1,18}|\d{0,18}\.\d{1,18}|\d{1,18}\.)([eE][-+]?\d{1,2})?", re.ASCII)
# So many characters of a text decide its place in a list: they also have room in the cursor of a page.
_KEY_CHARACTERS = 100
_Scalar = str | bool | int | float


def metadata_condition(expression: str) -> ColumnElement[bool]:
    """Return the condition of a comparison.

    Raises:
        InvalidQuery: it is not a comparison, or its value cannot be compared that way.
    """
    comparison = WHERE_EXPRESSION.fullmatch(expression.strip())
    if comparison is None:
        reason = "it is not a comparison; write FIELD=VALUE, or one of != < <= > >= ~ between them"
        raise InvalidQuery(expression=expression, reason=reason)
    path = comparison["field"].split(".")
    if "" in path:
        raise InvalidQuery(expression=expression, reason="the field has an empty part; write it like site.latitude")
    value = comparison["value"].strip()
    operator = comparison["operator"]
    if operator == "~":
        return _text_at(path).ilike(like_pattern(value), escape="\\")
    if operator in {"=", "!="}:
        equal = or_(*(_contains(path, candidate) for candidate in _readings(value)))
        return equal if operator == "=" else and_(_at(path).is_not(None), not_(equal))
    return _ordered(expression, path, operator, value)


def metadata_text(path: Sequence[str]) -> ColumnElement[str]:
    """Return a field of the mission's metadata as text, null where it has none."""
    return _text_at(path)


def metadata_key(path: Sequence[str]) -> ColumnElement[object]:
    """Return a field of the mission's metadata as a list is ordered by it, null where it has none.

    Text comes before numbers, numbers before booleans; lists and places are ordered as text.
    """
    value = _at(path)
    kind = func.jsonb_typeof(value)
    text = func.to_jsonb(func.left(_text_at(path), _KEY_CHARACTERS), type_=JSONB())
    key = case((kind.in_(["number", "boolean"]), value), (kind == "null", None), else_=text)
    return type_coerce(key, JSONB())


def _keys(path: Sequence[str]) -> ColumnElement[Sequence[str]]:
    return bindparam(None, list(path), type_=ARRAY(Text))


def _at(path: Sequence[str]) -> ColumnElement[object]:
    return mission.c.metadata.op("#>", return_type=JSONB())(_keys(path))


def _text_at(path: Sequence[str]) -> ColumnElement[str]:
    return mission.c.metadata.op("#>>", return_type=Text())(_keys(path))


def _contains(path: Sequence[str], value: _Scalar | list[_Scalar]) -> ColumnElement[bool]:
    document: object = value
    for key in reversed(path):
        document = {key: document}
    return mission.c.metadata.contains(document)


def _readings(value: str) -> list[_Scalar | list[_Scalar]]:
    """Return what a value may stand for in metadata: text, and a number or boolean where it reads as one."""
    text = _unquoted(value)
    scalars: list[_Scalar] = [value if text is None else text]
    if text is None:
        canonical = iso_text(value)
        scalars += [canonical] if canonical else []
        scalars += [_number(value)] if _NUMBER.fullmatch(value) else []
        scalars += [value.lower() == "true"] if value.lower() in {"true", "false"} else []
    return [*scalars, *([scalar] for scalar in scalars)]


def _unquoted(value: str) -> str | None:
    quoted = len(value) > 1 and value.startswith('"') and value.endswith('"')
    return value[1:-1] if quoted else None


def _number(value: str) -> int | float:
    return int(value) if value.lstrip("+-").isdigit() else float(value)


def _ordered(expression: str, path: Sequence[str], operator: str, value: str) -> ColumnElement[bool]:
    kind = func.jsonb_typeof(_at(path))
    text = _unquoted(value)
    if text is None and _NUMBER.fullmatch(value):
        # jsonb orders numbers as numbers; nothing is cast, so a mission with text there is passed over, not an error.
        return and_(
            kind == "number", _at(path).op(operator, is_comparison=True)(bindparam(None, _number(value), JSONB))
        )
    if text is None and value.lower() in {"true", "false"}:
        raise InvalidQuery(expression=expression, reason="true and false have no order; use = or !=")
    compared = text if text is not None else iso_text(value) or value
    stored = func.coalesce(_text_at(path), "").collate("C")
    return and_(kind == "string", stored.op(operator, is_comparison=True)(compared))
