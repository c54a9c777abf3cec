"""Writes a topic as a CSV file (RFC 4180, UTF-8), in the memory of a batch.

The columns are those of `to_arrow`. Times are integers of nanoseconds, and numbers the shortest text that reads back as
the same number. An array of up to `MAX_NUMBERED` numbers or texts has a column for each element, `ranges[0]`,
`ranges[1]`, …; rows with fewer elements leave the rest empty. Longer arrays, and arrays of types, are JSON; bytes are
base64. Null is an empty field.
"""

from __future__ import annotations

import base64
import csv
import io
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from kleinkram.recordings.messages import Selection
from kleinkram.recordings.writing.new_file import new_file
from kleinkram.recordings.writing.topic_rows import (
    BATCH_BYTES,
    FrameNames,
    OnRows,
    TopicGroup,
    Written,
    rows_of,
    schema_of,
)

MAX_NUMBERED = 64
"""Elements of an array that have a column each; a covariance has 36."""

_SLICE_ROWS = 4096
_NOT_FINITE = {"nan": '"NaN"', "inf": '"Infinity"', "-inf": '"-Infinity"'}


def write_csv(group: TopicGroup, path: Path, selection: Selection, on_rows: OnRows) -> Written:
    """Write the rows of a topic to a new file.

    Reads the messages twice where the type has arrays of any length.

    Raises:
        CannotWrite: the file exists, or its folder cannot be written to or is full.
        pyarrow.ArrowException: the columns of two recordings contradict each other.
    """
    schema = schema_of(group, selection)
    lengths = _lengths_of(group, schema, selection)
    frames = FrameNames()
    row_count, has_header = 0, False
    with new_file(path) as stream:
        text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
        writer = csv.writer(text, lineterminator="\r\n")
        for table in rows_of(group, schema, selection):
            if not has_header:
                writer.writerow([name for field in table.schema for name in _headers(field.name, lengths)])
                has_header = True
            frames.note(table)
            for part in _slices(table):
                cells = [cell for field in part.schema for cell in _cells(part, field, lengths)]
                writer.writerows(zip(*cells, strict=True))
            row_count += table.num_rows
            on_rows(table.num_rows)
            del table
        text.detach()
        size_bytes = stream.tell()
    return Written(row_count, size_bytes, frames.only)


def _slices(table: Any) -> Iterator[Any]:
    """Yield some rows at a time: texts take many times the memory of numbers."""
    rows = max(1, min(_SLICE_ROWS, table.num_rows * BATCH_BYTES // max(1, table.nbytes)))
    for start in range(0, table.num_rows, rows):
        yield table.slice(start, rows)


def _headers(name: str, lengths: dict[str, int]) -> list[str]:
    return [f"{name}[{number}]" for number in range(lengths[name])] if name in lengths else [name]


def _lengths_of(group: TopicGroup, schema: Any, selection: Selection) -> dict[str, int]:
    """Return the number of elements of each array that has a column for each."""
    import pyarrow as pa

    lengths: dict[str, int] = {}
    growing: list[str] = []
    for field in schema:
        if not _is_listed(field.type) or not _is_plain(field.type.value_type):
            continue
        if pa.types.is_fixed_size_list(field.type):
            lengths[field.name] = field.type.list_size
        else:
            growing.append(field.name)
    if growing:
        lengths |= _longest(group, schema, selection, growing)
    return {name: length for name, length in lengths.items() if 0 < length <= MAX_NUMBERED}


def _longest(group: TopicGroup, schema: Any, selection: Selection, names: Sequence[str]) -> dict[str, int]:
    import pyarrow.compute as pc

    longest = dict.fromkeys(names, 0)
    for table in rows_of(group, schema, selection):
        for name in names:
            longest[name] = max(longest[name], pc.max(pc.list_value_length(table[name])).as_py() or 0)
        del table
    return longest


def _is_listed(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind))


def _is_plain(kind: Any) -> bool:
    """Return whether a value is one number, truth value or text."""
    import pyarrow as pa

    checks = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_string)
    return any(check(kind) for check in checks)


def _cells(table: Any, field: Any, lengths: dict[str, int]) -> Sequence[Sequence[str | None]]:
    """Return the texts of a column: one list, or one for each element of its arrays."""
    column = table[field.name].combine_chunks()
    return _elements(column, lengths[field.name]) if field.name in lengths else [_texts(column)]


def _elements(column: Any, length: int) -> Sequence[Sequence[str | None]]:
    rows = [[*row, *[None] * (length - len(row))] for row in _rows(column)]
    return [*zip(*rows, strict=True)]


def _rows(column: Any) -> Iterator[list[str | None]]:
    """Yield the texts of the elements of each array; none of null."""
    import pyarrow.compute as pc

    texts = iter(_texts(column.flatten()))
    for size in pc.list_value_length(column).to_pylist():
        yield [*itertools.islice(texts, size or 0)]


def _texts(column: Any) -> list[str | None]:
    """Return the values of a column as texts, without loss; None for null."""
    import pyarrow as pa

    kind = column.type
    if _is_plain(kind) or pa.types.is_null(kind):
        return list(column.cast(pa.string()).to_pylist())
    if _is_listed(kind) and _is_plain(kind.value_type) and not pa.types.is_string(kind.value_type):
        are_valid = column.is_valid().to_pylist()
        return [_json_list(row) if is_valid else None for row, is_valid in zip(_rows(column), are_valid, strict=True)]
    return [None if value is None else _as_text(value) for value in column.to_pylist()]


def _json_list(texts: Iterable[str | None]) -> str:
    """Return numbers or truth values as JSON, in fewer digits than `json` writes a float32 with."""
    return f"[{','.join('null' if text is None else _NOT_FINITE.get(text, text) for text in texts)}]"


def _as_text(value: object) -> str:
    plain = _json_value(value)
    return plain if isinstance(plain, str) else json.dumps(plain, ensure_ascii=False, allow_nan=False)


def _json_value(value: Any) -> Any:
    """Return a value as protobuf's JSON has it: bytes as base64, NaN and infinities as texts."""
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, dict):
        return {name: _json_value(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(part) for part in value]
    return value
