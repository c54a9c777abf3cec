"""Builds Arrow batches of JSON and protobuf messages, whose columns depend on the messages.

Where the values of a JSON field disagree on their type, the column takes the most frequent one; a value that does not
fit is null and reported. Whole numbers are int64, or uint64 if one needs it and none is negative; with fractions among
them all are float64.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import pyarrow as pa

from kleinkram.recordings.decoding.decoder import Decoder
from kleinkram.recordings.decoding.tables import TIME_COLUMNS, NoSuchField, Notice, timed_batch
from kleinkram.recordings.decoding.types import DecodeError
from kleinkram.recordings.decoding.values import to_row

_INT64 = range(-(2**63), 2**63)
_UINT64 = range(2**64)
_SHOWN = 40


class JsonArrays:
    """Builds the arrays of one batch of JSON messages; `notice` receives log times and what of the message is null."""

    def __init__(self, type_name: str, log_ns: list[int], notice: Callable[[int, DecodeError], None]) -> None:
        self._type_name = type_name
        self._log_ns = log_ns
        self._notice = notice

    def build(self, values: list[Any], name: str = "") -> Any:
        """Return one array of all messages, or of one field of them; never raises because of a value."""
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
            return pa.array(self._checked(name, "text", values, rows, partial(_fits, str.encode)), pa.string())
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
            values = self._checked(name, "float64", values, rows, partial(_fits, float))
            return pa.array([None if value is None else float(value) for value in values], pa.float64())
        needs_unsigned = any(value not in _INT64 for value in present) and all(value >= 0 for value in present)
        kind, bounds = ("uint64", _UINT64) if needs_unsigned else ("int64", _INT64)
        values = self._checked(name, kind, values, rows, lambda value: value in bounds)
        return pa.array(values, pa.uint64() if needs_unsigned else pa.int64())

    def _checked(
        self, name: str, kind: str, values: list[Any], rows: list[int], fits: Callable[[Any], bool]
    ) -> list[Any]:
        """Return the values, with None for those that do not fit, which are reported."""
        fitting = []
        for value, row in zip(values, rows, strict=True):
            is_fitting = value is None or fits(value)
            fitting.append(value if is_fitting else None)
            if not is_fitting:
                is_short = not isinstance(value, int) or value.bit_length() < 256
                shown = ascii(value)[:_SHOWN] if is_short else "a number beyond all columns"
                message = f"its field '{(name or 'value')[:100]}' is {shown}, which a column of {kind} cannot hold"
                self._notice(self._log_ns[row], DecodeError(self._type_name, message))
        return fitting


def joined(type_name: str, tables: Iterable[Any], notice: Callable[[int, DecodeError], None]) -> Any:
    """Return batches as one table. A column whose type differs between batches is rebuilt from all its values."""
    tables = list(tables)
    for name in dict.fromkeys(name for table in tables for name in table.column_names):
        having = [index for index, table in enumerate(tables) if name in table.column_names]
        try:
            pa.concat_tables([tables[index].select([name]) for index in having], promote_options="permissive")
        except pa.ArrowException:
            log_ns = [stamp for index in having for stamp in tables[index]["log_time_ns"].to_pylist()]
            values = [value for index in having for value in tables[index][name].to_pylist()]
            array = JsonArrays(type_name, log_ns, notice).build(values, name)
            at = 0
            for index in having:
                table = tables[index]
                column = array.slice(at, len(table))
                tables[index] = table.set_column(table.column_names.index(name), name, column)
                at += len(table)
    return pa.concat_tables(tables, promote_options="permissive")


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


def _fits(convert: Callable[[Any], object], value: object) -> bool:
    try:
        convert(value)
    except (OverflowError, UnicodeEncodeError):
        return False
    return True


class JsonRows:
    """Builds batches of JSON and protobuf messages."""

    def __init__(self, decoder: Decoder, fields: Sequence[str] | None, notice: Notice) -> None:
        self._decoder = decoder
        self._fields = fields
        self._notice = notice

    def __call__(self, log_ns: list[int], publish_ns: list[int], data: list[bytes]) -> Any:
        """Return the batch of some messages."""
        values = [self._decoded(log, raw) for log, raw in zip(log_ns, data, strict=True)]
        try:
            array = pa.array(values)
        except (ValueError, TypeError, OverflowError, pa.ArrowException):
            array = JsonArrays(self._decoder.type_name, log_ns, self._notice).build(values)
        # Names that are taken get a "_" behind them: {"a.b": 1, "a": {"b": 2}} has two columns.
        named, taken = [], set(TIME_COLUMNS)
        for name, part in _flattened("", array):
            while name in taken:
                name += "_"
            taken.add(name)
            named.append((name, part))
        if self._fields is not None:
            names = [name for name, _ in named]
            for field in self._fields if values else ():
                if not any(_below(name, field) for name in names):
                    message = f"there is no field '{field}'; there are {', '.join(names[:40])}"
                    raise NoSuchField(self._decoder.type_name, message)
            named = [(name, part) for name, part in named if any(_below(name, field) for field in self._fields)]
        return timed_batch(log_ns, publish_ns, [name for name, _ in named], [part for _, part in named])

    def _decoded(self, log_ns: int, data: bytes) -> Any:
        try:
            value = to_row(self._decoder.decode(data))
        except DecodeError as error:
            self._notice(log_ns, error)
            return None
        return value if isinstance(value, dict) else {"value": value}


def _below(name: str, field: str) -> bool:
    return name == field or name.startswith(f"{field}.")


def _flattened(prefix: str, array: Any) -> list[tuple[str, Any]]:
    if not pa.types.is_struct(array.type):
        return [(prefix, array)] if prefix else []
    columns: list[tuple[str, Any]] = []
    for field, part in zip(array.type, array.flatten(), strict=True):
        columns += _flattened(f"{prefix}.{field.name}" if prefix else field.name, part)
    return columns
