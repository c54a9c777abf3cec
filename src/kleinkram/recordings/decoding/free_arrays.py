"""Values of JSON messages as Arrow arrays where they do not agree on their types: what does not fit is null and named.

A column has the type that most of its values have. Whole numbers are int64, or uint64 if they need it and none is
negative; with fractions among them all are float64.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import pyarrow as pa

from kleinkram.recordings.decoding.errors import DecodeError

_INT64 = range(-(2**63), 2**63)
_UINT64 = range(2**64)
_SHOWN = 40


class FreeArrays:
    """Builds the arrays of one batch of messages.

    Attributes:
        type_name: of the messages, for errors.
        log_ns: the log time of each message.
        notice: called with the log time of a message and what of it is null.
    """

    def __init__(self, type_name: str, log_ns: list[int], notice: Callable[[int, DecodeError], None]) -> None:
        self._type_name = type_name
        self._log_ns = log_ns
        self._notice = notice

    def build(self, values: list[Any]) -> Any:
        """Return one array of all messages; never raises for what a value is."""
        return self.build_field("", values)

    def build_field(self, name: str, values: list[Any]) -> Any:
        """Return the array of one field of all messages; never raises for what a value is."""
        return self._array(name, values, list(range(len(values))))

    def _array(self, name: str, values: list[Any], rows: list[int]) -> Any:
        """Return the values of a field; `rows`: the message that each belongs to."""
        kinds = Counter(_kind(value) for value in values if value is not None)
        if not kinds:
            return pa.nulls(len(values))
        (kind, _), *others = kinds.most_common()
        if others:
            values = self._checked(name, kind, values, rows, lambda value: _kind(value) == kind)
        if kind == "object":
            return self._structs(name, values, rows)
        if kind == "list":
            return self._lists(name, values, rows)
        if kind == "number":
            return self._numbers(name, values, rows)
        if kind == "text":
            return pa.array(self._checked(name, "text", values, rows, _is_utf8), pa.string())
        return pa.array(values)

    def _structs(self, name: str, values: list[Any], rows: list[int]) -> Any:
        keys = dict.fromkeys(key for value in values if value is not None for key in value)
        parts = {
            key: self._array(f"{name}.{key}" if name else str(key), [v and v.get(key) for v in values], rows)
            for key in keys
        }
        if not parts:
            return pa.array([None if value is None else {} for value in values], pa.struct([]))
        names = [str(key).encode("utf-8", "replace").decode() for key in parts]
        is_null = pa.array([value is None for value in values])
        return pa.StructArray.from_arrays(list(parts.values()), names=names, mask=is_null)

    def _lists(self, name: str, values: list[Any], rows: list[int]) -> Any:
        offsets: list[int | None] = []
        inside: list[Any] = []
        inside_rows: list[int] = []
        for value, row in zip(values, rows, strict=True):
            offsets.append(None if value is None else len(inside))
            inside += value or ()
            inside_rows += [row] * len(value or ())
        offsets.append(len(inside))
        return pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), self._array(name, inside, inside_rows))

    def _numbers(self, name: str, values: list[Any], rows: list[int]) -> Any:
        present = [value for value in values if value is not None]
        if any(isinstance(value, float) for value in present):
            values = self._checked(name, "float64", values, rows, _is_float)
            return pa.array([None if value is None else float(value) for value in values], pa.float64())
        needs_unsigned = any(value not in _INT64 for value in present) and all(value >= 0 for value in present)
        kind, bounds = ("uint64", _UINT64) if needs_unsigned else ("int64", _INT64)
        values = self._checked(name, kind, values, rows, lambda value: value in bounds)
        return pa.array(values, pa.uint64() if needs_unsigned else pa.int64())

    def _checked(
        self, name: str, kind: str, values: list[Any], rows: list[int], fits: Callable[[Any], bool]
    ) -> list[Any]:
        """Return the values with None for those that do not fit, which are named."""
        kept = []
        for value, row in zip(values, rows, strict=True):
            is_kept = value is None or fits(value)
            kept.append(value if is_kept else None)
            if not is_kept:
                self._notice(self._log_ns[row], _misfit(self._type_name, name or "value", kind, value))
        return kept


def joined(type_name: str, tables: Iterable[Any], notice: Callable[[int, DecodeError], None]) -> Any:
    """Return batches as one table. A column on whose type they do not agree is made anew of all its values."""
    tables = list(tables)
    for name in dict.fromkeys(name for table in tables for name in table.column_names):
        having = [place for place, table in enumerate(tables) if name in table.column_names]
        try:
            pa.concat_tables([tables[place].select([name]) for place in having], promote_options="permissive")
        except pa.ArrowException:
            log_ns = [stamp for place in having for stamp in tables[place]["log_time_ns"].to_pylist()]
            values = [value for place in having for value in tables[place][name].to_pylist()]
            array = FreeArrays(type_name, log_ns, notice).build_field(name, values)
            at = 0
            for place in having:
                table = tables[place]
                column = array.slice(at, len(table))
                tables[place] = table.set_column(table.column_names.index(name), name, column)
                at += len(table)
    return pa.concat_tables(tables, promote_options="permissive")


def _misfit(type_name: str, name: str, kind: str, value: object) -> DecodeError:
    shown = ascii(value) if not isinstance(value, int) or value.bit_length() < 256 else "a number beyond all columns"
    return DecodeError(type_name, f"its field '{name[:100]}' is {shown[:_SHOWN]}, which a column of {kind} cannot hold")


def _kind(value: object) -> str:
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, (int, float)):
        return "number"
    if isinstance(value, str):
        return "text"
    if isinstance(value, dict):
        return "object"
    return "list" if isinstance(value, list) else "bytes"


def _is_float(value: float) -> bool:
    try:
        float(value)
    except OverflowError:
        return False
    return True


def _is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
