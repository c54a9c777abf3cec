"""Messages of one topic -> an Arrow table, fast where messages have one shape, and right where they have not.

Every table begins with `log_time_ns` and `publish_time_ns` (int64, nanoseconds of the log clock; null beyond what
int64 holds), then the columns of the type as `columns` says. A message that cannot be decoded keeps its row: its times
are there, its fields are null. Rows stand in the order in which messages were given. JSON and protobuf messages have
the columns that they turn out to have; messages without a decoder have one column `data`.

Memory: one batch of at most `BATCH_BYTES` of messages at a time, several times over; `to_arrow` keeps the whole table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding.columns import (
    Column,
    NoSuchField,
    arrow_type,
    column_name,
    columns_of,
    is_bytes,
    is_time,
)
from kleinkram.recordings.decoding.decoder import Decoder
from kleinkram.recordings.decoding.errors import DecodeError, ReadingExtraMissing, Undecodable
from kleinkram.recordings.decoding.limits import BATCH_BYTES, BATCH_MESSAGES
from kleinkram.recordings.decoding.schema import Array, Struct, Type
from kleinkram.recordings.decoding.shapes import NoShape, shape_of
from kleinkram.recordings.decoding.values import NS, Value, to_row

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

TimedMessage = tuple[int, int, bytes]
"""(log time, publish time, bytes); times in nanoseconds."""
Notice = Callable[[int, DecodeError], None]
"""Called with the log time of each message that cannot be decoded, and why."""


def _ignore(log_time_ns: int, error: DecodeError) -> None:
    """Take notice of nothing."""


_MOST_SHAPES = 32
_LEAST_ROWS = 16
_TIMES = ("log_time_ns", "publish_time_ns")


def to_arrow(
    decoder: Decoder | Undecodable,
    messages: Iterable[TimedMessage],
    *,
    fields: Sequence[str] | None = None,
    notice: Notice | None = None,
) -> pa.Table:
    """Return the messages of one schema as a table.

    Args:
        decoder: of the schema.
        messages: (log time, publish time, bytes), in the order that rows shall have.
        fields: dotted names; a name takes all that lies below it, such as "header" or "pose.position.x".
        notice: called for each message that cannot be decoded, and each value of JSON that its column cannot hold;
            that value is null.

    Raises:
        NoSuchField: a name that fits no column.
        ReadingExtraMissing: numpy or pyarrow is not installed.
    """
    pa = _arrow()
    tables = [
        pa.Table.from_batches([batch]) for batch in arrow_batches(decoder, messages, fields=fields, notice=notice)
    ]
    try:
        return pa.concat_tables(tables, promote_options="permissive")
    except pa.ArrowException:  # batches of JSON whose values changed their types
        from kleinkram.recordings.decoding.free_arrays import joined

        return joined(decoder.type_name, tables, notice or _ignore)


def to_pandas(
    decoder: Decoder | Undecodable,
    messages: Iterable[TimedMessage],
    *,
    fields: Sequence[str] | None = None,
    notice: Notice | None = None,
) -> pd.DataFrame:
    """Return what `to_arrow` returns as a pandas frame.

    Raises:
        NoSuchField: a name that fits no column.
        ReadingExtraMissing: numpy, pyarrow or pandas is not installed.
    """
    try:
        import pandas  # noqa: F401  # only to name it where it is missing
    except ImportError:
        raise ReadingExtraMissing("pandas") from None
    return to_arrow(decoder, messages, fields=fields, notice=notice).to_pandas()


def arrow_batches(
    decoder: Decoder | Undecodable,
    messages: Iterable[TimedMessage],
    *,
    fields: Sequence[str] | None = None,
    notice: Notice | None = None,
) -> Iterator[pa.RecordBatch]:
    """Yield the rows of `to_arrow` in bounded batches; at least one, which may be empty.

    Batches of ROS messages all have one Arrow schema; those of JSON and protobuf each have the columns that they need.

    Raises:
        NoSuchField: a name that fits no column.
        ReadingExtraMissing: numpy or pyarrow is not installed.
    """
    _arrow()
    rows = _rows_of(decoder, fields, notice or _ignore)
    is_first = True
    for log_ns, publish_ns, data in _batches(messages):
        yield rows(log_ns, publish_ns, data)
        is_first = False
    if is_first:
        yield rows([], [], [])


Rows = Callable[[list[int], list[int], list[bytes]], Any]


def _arrow() -> Any:
    try:
        import numpy  # noqa: F401  # only to name it where it is missing
        import pyarrow as pa
    except ImportError as error:
        raise ReadingExtraMissing(error.name or "pyarrow") from None
    return pa


def _batches(messages: Iterable[TimedMessage]) -> Iterator[tuple[list[int], list[int], list[bytes]]]:
    log_ns: list[int] = []
    publish_ns: list[int] = []
    data: list[bytes] = []
    size = 0
    for log, publish, raw in messages:
        if data and (size + len(raw) > BATCH_BYTES or len(data) >= BATCH_MESSAGES):
            yield log_ns, publish_ns, data
            log_ns, publish_ns, data, size = [], [], [], 0
        log_ns.append(log)
        publish_ns.append(publish)
        data.append(raw)
        size += len(raw)
    if data:
        yield log_ns, publish_ns, data


def _rows_of(decoder: Decoder | Undecodable, fields: Sequence[str] | None, notice: Notice) -> Rows:
    if isinstance(decoder, Undecodable):
        return _raw_rows
    if decoder.struct is None:
        return _FreeRows(decoder, fields, notice)
    return _TypedRows(decoder, decoder.struct, columns_of(decoder.struct, fields), notice)


def _timed(log_ns: list[int], publish_ns: list[int], names: list[str], arrays: list[Any]) -> Any:
    import pyarrow as pa

    times = [_times(column) for column in (log_ns, publish_ns)]
    return pa.RecordBatch.from_arrays([*times, *arrays], names=[*_TIMES, *names])


def _times(stamps: list[int]) -> Any:
    import numpy as np

    from kleinkram.recordings.decoding.gather import arrow_of

    times = np.fromiter(stamps, np.uint64, len(stamps)).view(np.int64)
    return arrow_of(times, times >= 0)


def _raw_rows(log_ns: list[int], publish_ns: list[int], data: list[bytes]) -> Any:
    import pyarrow as pa

    return _timed(log_ns, publish_ns, ["data"], [pa.array([bytes(raw) for raw in data], pa.binary())])


class _TypedRows:
    """Batches of a ROS type: messages of one shape together, the rest one by one."""

    def __init__(self, decoder: Decoder, struct: Struct, columns: list[Column], notice: Notice) -> None:
        self._decoder = decoder
        self._struct = struct
        self._columns = columns
        self._notice = notice

    def __call__(self, log_ns: list[int], publish_ns: list[int], data: list[bytes]) -> Any:
        import numpy as np
        import pyarrow as pa

        from kleinkram.recordings.decoding.gather import arrow_of

        groups: list[tuple[Any, list[Any]]] = []
        single: list[int] = []
        for places in _by_size(data):
            left = self._shaped(places, data, groups)
            single += left.tolist()
        if single or not groups:
            single.sort()
            values = [self._decoded(log_ns[place], data[place]) for place in single]
            groups.append((np.array(single, np.int64), [_column(column, values) for column in self._columns]))
        if len(groups) == 1:
            return _timed(log_ns, publish_ns, [c.name for c in self._columns], groups[0][1])
        order = arrow_of(np.argsort(np.concatenate([places for places, _ in groups]), kind="stable"))
        joined = [pa.concat_arrays([arrays[n] for _, arrays in groups]).take(order) for n in range(len(self._columns))]
        return _timed(log_ns, publish_ns, [c.name for c in self._columns], joined)

    def _shaped(self, places: Any, data: list[bytes], groups: list[tuple[Any, list[Any]]]) -> Any:
        """Read messages of one size by their shapes; returns the places of those that are left."""
        import numpy as np

        from kleinkram.recordings.decoding.gather import gather

        if len(places) < _LEAST_ROWS:
            return places
        rows = np.frombuffer(b"".join([data[place] for place in places.tolist()]), np.uint8)
        rows = rows.reshape(len(places), -1)
        for _ in range(_MOST_SHAPES):
            try:
                shape = shape_of(self._struct, rows[0].tobytes(), self._decoder.message_encoding)
                fixed = list(shape.fixed)
                fits = (rows[:, fixed] == rows[0, fixed]).all(axis=1)
                if fits.sum() < _LEAST_ROWS:
                    return places
                is_whole = bool(fits.all())
                groups.append((places[fits], gather(rows if is_whole else rows[fits], shape, self._columns)))
            except NoShape:
                return places
            places, rows = places[~fits], rows[~fits]
            if len(places) < _LEAST_ROWS:
                return places
        return places

    def _decoded(self, log_ns: int, data: bytes) -> Value | None:
        try:
            return self._decoder.decode(data)  # type: ignore[return-value]  # a type with a layout makes values
        except DecodeError as error:
            self._notice(log_ns, error)
            return None


def _by_size(data: list[bytes]) -> Iterator[Any]:
    """Yield the places of messages of one size, for each size."""
    import numpy as np

    sizes = np.fromiter(map(len, data), np.int64, len(data))
    order = np.argsort(sizes, kind="stable")
    ends = np.flatnonzero(np.diff(sizes[order])) + 1
    yield from np.split(order, ends) if len(order) else ()


def _column(column: Column, values: list[Any]) -> Any:
    """Return one column of decoded messages (None: undecodable)."""
    import pyarrow as pa

    for name in column.names:
        values = [None if value is None else getattr(value, name, None) for value in values]
    return pa.array([None if value is None else _cell(column.kind, value) for value in values], arrow_type(column.kind))


def _cell(kind: Type, value: Any) -> Any:
    """Return a value as Arrow takes it; None where the definition of another release lacks a field."""
    if value is None:
        return None
    if is_time(kind):
        whole, rest = (getattr(value, name) for name in value._fields)
        return whole * NS + rest
    if isinstance(kind, Struct):
        return {
            column_name(field.name, field.type): _cell(field.type, getattr(value, field.name, None))
            for field in kind.fields
        }
    if isinstance(kind, Array):
        if is_bytes(kind):
            return value.tobytes()
        if hasattr(value, "dtype"):
            return value if value.dtype.isnative else value.astype(value.dtype.newbyteorder("="))
        return [_cell(kind.element, part) for part in value]
    return value


class _FreeRows:
    """Batches of messages whose columns show only when they are read: JSON and protobuf."""

    def __init__(self, decoder: Decoder, fields: Sequence[str] | None, notice: Notice) -> None:
        self._decoder = decoder
        self._fields = fields
        self._notice = notice

    def __call__(self, log_ns: list[int], publish_ns: list[int], data: list[bytes]) -> Any:
        import pyarrow as pa

        from kleinkram.recordings.decoding.free_arrays import FreeArrays

        values = [self._decoded(log, raw) for log, raw in zip(log_ns, data, strict=True)]
        try:
            array = pa.array(values)
        except (ValueError, TypeError, OverflowError, pa.ArrowException):
            array = FreeArrays(self._decoder.type_name, log_ns, self._notice).build(values)
        named = _named_once(_flattened("", array))
        if self._fields is not None:
            self._check([name for name, _ in named] if values else list(self._fields))
            named = [(name, part) for name, part in named if any(_below(name, wanted) for wanted in self._fields)]
        return _timed(log_ns, publish_ns, [name for name, _ in named], [part for _, part in named])

    def _check(self, names: list[str]) -> None:
        for wanted in self._fields or ():
            if not any(_below(name, wanted) for name in names):
                raise NoSuchField(
                    self._decoder.type_name, f"there is no field '{wanted}'; there are {', '.join(names[:40])}"
                )

    def _decoded(self, log_ns: int, data: bytes) -> Any:
        try:
            value = to_row(self._decoder.decode(data))
        except DecodeError as error:
            self._notice(log_ns, error)
            return None
        return value if isinstance(value, dict) else {"value": value}


def _named_once(named: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """Put "_" behind names that are taken: {"a.b": 1, "a": {"b": 2}} has two columns."""
    taken = set(_TIMES)
    found = []
    for name, array in named:
        while name in taken:
            name += "_"
        taken.add(name)
        found.append((name, array))
    return found


def _below(name: str, wanted: str) -> bool:
    return name == wanted or name.startswith(f"{wanted}.")


def _flattened(prefix: str, array: Any) -> list[tuple[str, Any]]:
    import pyarrow as pa

    if not pa.types.is_struct(array.type):
        return [(prefix, array)] if prefix else []
    found: list[tuple[str, Any]] = []
    for field, part in zip(array.type, array.flatten(), strict=True):
        found += _flattened(f"{prefix}.{field.name}" if prefix else field.name, part)
    return found
