"""Messages of one topic as an Arrow table or a pandas frame.

Every table begins with `log_time_ns` and `publish_time_ns` (int64, nanoseconds of the log clock; null beyond int64),
then the columns of the type. Rows keep the order of the messages. A message that cannot be decoded keeps its row with
null fields. JSON and protobuf messages get the columns that they turn out to have; messages without a decoder get one
column `data`.

Nested types become columns with dotted names, a time or duration one column of int64 nanoseconds named `..._ns`
(`header.stamp` -> `header.stamp_ns`). Arrays of fixed length are fixed-size lists, others lists; `uint8[]` is binary.
Types inside arrays are structs with the same rules.

Memory: one batch of at most `BATCH_BYTES` of messages at a time, copied several times; `to_arrow` returns all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding import types
from kleinkram.recordings.decoding.decoder import Decoder
from kleinkram.recordings.decoding.types import DecodeError, ReadingExtraMissing, Struct, Type, Undecodable

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

Notice = Callable[[int, DecodeError], None]
"""Called with the log time of each message that cannot be decoded, and the error."""
TIME_COLUMNS = ("log_time_ns", "publish_time_ns")
_TIME_FIELDS = {("sec", "nanosec"), ("secs", "nsecs")}


class NoSuchField(DecodeError):
    """The messages have no field of that name."""


@dataclass(frozen=True)
class TableColumn:
    """One column: the positions of its field, from the message inwards, and the attributes by which it is reached."""

    name: str
    path: tuple[int, ...]
    names: tuple[str, ...]
    kind: Type


def is_time(kind: Type) -> bool:
    """Return whether a type is a time or a duration."""
    if not isinstance(kind, Struct) or kind.name.rpartition("/")[2].lower() not in ("time", "duration"):
        return False
    return tuple(field.name for field in kind.fields) in _TIME_FIELDS


def column_name(name: str, kind: Type) -> str:
    """Return the name of a field's column: its unit follows a time's."""
    return f"{name}_ns" if is_time(kind) else name


def columns_of(root: Struct, fields: Sequence[str] | None) -> list[TableColumn]:
    """Return the columns of a type; with `fields`, only those named or below a name, in the type's order."""
    columns = list(_flat(root, (), ()))
    if fields is None:
        return columns
    for name in fields:
        if not any(_is_selected(column, name) for column in columns):
            known = ", ".join(column.name for column in columns[:40])
            raise NoSuchField(root.name, f"there is no field '{name}'; there are {known}")
    return [column for column in columns if any(_is_selected(column, name) for name in fields)]


def _is_selected(column: TableColumn, name: str) -> bool:
    path = ".".join(column.names)
    return name in (column.name, path) or path.startswith(f"{name}.")


def _flat(kind: Struct, path: tuple[int, ...], names: tuple[str, ...]) -> Iterator[TableColumn]:
    for position, field in enumerate(kind.fields):
        here, called = (*path, position), (*names, field.name)
        if isinstance(field.type, Struct) and not is_time(field.type):
            yield from _flat(field.type, here, called)
        else:
            yield TableColumn(column_name(".".join(called), field.type), here, called, field.type)


def arrow_type(kind: Type) -> Any:
    """Return the Arrow type of a field."""
    import pyarrow as pa

    if isinstance(kind, types.Primitive):
        if kind.code in ("", "?"):
            return pa.bool_() if kind.code else pa.string()
        return getattr(pa, kind.name)()
    if is_time(kind):
        return pa.int64()
    if isinstance(kind, Struct):
        return pa.struct([(column_name(field.name, field.type), arrow_type(field.type)) for field in kind.fields])
    if is_bytes(kind):
        return pa.binary()
    element = arrow_type(kind.element)
    return pa.list_(element) if kind.length is None else pa.list_(element, kind.length)


def is_bytes(kind: types.Array) -> bool:
    """Return whether an array is stored as binary: `uint8` of variable length."""
    return kind.length is None and isinstance(kind.element, types.Primitive) and kind.element.name == "uint8"


def arrow_of(values: Any, valid: Any = None) -> Any:
    """Return numbers or booleans as an Arrow array that shares their memory; null where `valid` is False.

    `pa.array` would import pandas to check for a series (60 MB, half a second).
    """
    import numpy as np
    import pyarrow as pa

    bitmap = None if valid is None or valid.all() else _bits(valid)
    stored = _bits(values) if values.dtype == np.bool_ else pa.py_buffer(np.ascontiguousarray(values))
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [bitmap, stored])


def _bits(flags: Any) -> Any:
    import numpy as np
    import pyarrow as pa

    return pa.py_buffer(np.packbits(flags, bitorder="little"))


def timed_batch(log_ns: list[int], publish_ns: list[int], names: list[str], arrays: list[Any]) -> Any:
    """Return a record batch whose first columns are the times."""
    import numpy as np
    import pyarrow as pa

    times = [np.fromiter(stamps, np.uint64, len(stamps)).view(np.int64) for stamps in (log_ns, publish_ns)]
    columns = [*(arrow_of(column, column >= 0) for column in times), *arrays]
    return pa.RecordBatch.from_arrays(columns, names=[*TIME_COLUMNS, *names])


TimedMessage = tuple[int, int, bytes]  # (log time, publish time, bytes); times in nanoseconds


def _ignore(log_time_ns: int, error: DecodeError) -> None:
    """Ignore messages that cannot be decoded."""


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
        messages: (log time, publish time, bytes), in the order of the rows.
        fields: dotted names; a name takes all that lies below it, such as "header" or "pose.position.x".
        notice: called for each message that cannot be decoded, and each value of JSON that its column cannot hold;
            that value becomes null.

    Raises:
        NoSuchField: a name that fits no column.
        ReadingExtraMissing: numpy or pyarrow is not installed.
    """
    pa = load_pyarrow()
    tables = [
        pa.Table.from_batches([batch]) for batch in arrow_batches(decoder, messages, fields=fields, notice=notice)
    ]
    try:
        return pa.concat_tables(tables, promote_options="permissive")
    except pa.ArrowException:  # batches of JSON whose values changed their types
        from kleinkram.recordings.decoding.json_to_arrow import joined

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
    batch_bytes: int = types.BATCH_BYTES,
) -> Iterator[pa.RecordBatch]:
    """Yield the rows of `to_arrow` in batches of messages of at most so many bytes; at least one, which may be empty.

    Batches of ROS messages all have one Arrow schema; those of JSON and protobuf each have the columns that they need.

    Raises:
        NoSuchField: a name that fits no column.
        ReadingExtraMissing: numpy or pyarrow is not installed.
    """
    load_pyarrow()
    rows: Callable[[list[int], list[int], list[bytes]], Any]
    if isinstance(decoder, Undecodable):
        rows = _raw_rows
    elif decoder.struct is None:
        from kleinkram.recordings.decoding.json_to_arrow import JsonRows

        rows = JsonRows(decoder, fields, notice or _ignore)
    else:
        from kleinkram.recordings.decoding.ros_to_arrow import TypedRows

        rows = TypedRows(decoder, decoder.struct, columns_of(decoder.struct, fields), notice or _ignore)
    is_first = True
    for log_ns, publish_ns, data in _batches(messages, batch_bytes):
        batch = rows(log_ns, publish_ns, data)
        del log_ns, publish_ns, data  # one batch at a time is in memory
        yield batch
        del batch
        is_first = False
    if is_first:
        yield rows([], [], [])


def _raw_rows(log_ns: list[int], publish_ns: list[int], data: list[bytes]) -> Any:
    import pyarrow as pa

    return timed_batch(log_ns, publish_ns, ["data"], [pa.array([bytes(raw) for raw in data], pa.binary())])


def load_pyarrow() -> Any:
    """Return pyarrow; `ReadingExtraMissing` if it or numpy is not installed."""
    try:
        import numpy  # noqa: F401  # only to name it where it is missing
        import pyarrow as pa
    except ImportError as error:
        raise ReadingExtraMissing(error.name or "pyarrow") from None
    return pa


def _batches(messages: Iterable[TimedMessage], batch_bytes: int) -> Iterator[tuple[list[int], list[int], list[bytes]]]:
    log_ns: list[int] = []
    publish_ns: list[int] = []
    data: list[bytes] = []
    size = 0
    for log, publish, raw in messages:
        if data and (size + len(raw) > batch_bytes or len(data) >= types.BATCH_MESSAGES):
            yield log_ns, publish_ns, data
            log_ns, publish_ns, data, size = [], [], [], 0
        log_ns.append(log)
        publish_ns.append(publish)
        data.append(raw)
        size += len(raw)
    if data:
        yield log_ns, publish_ns, data
