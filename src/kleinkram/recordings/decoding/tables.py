"""Messages of one topic as an Arrow table or a pandas frame.

Every table begins with `log_time_ns` and `publish_time_ns` (int64, nanoseconds of the log clock; null beyond int64),
then the columns of the type (see `columns`). Rows keep the order of the messages. A message that cannot be decoded
keeps its row with null fields. JSON and protobuf messages get the columns that they turn out to have; messages without
a decoder get one column `data`.

Memory: one batch of at most `BATCH_BYTES` of messages at a time, copied several times; `to_arrow` returns all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding.columns import Notice, columns_of, timed_batch
from kleinkram.recordings.decoding.decoder import Decoder
from kleinkram.recordings.decoding.errors import DecodeError, ReadingExtraMissing, Undecodable
from kleinkram.recordings.decoding.types import BATCH_BYTES, BATCH_MESSAGES

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

TimedMessage = tuple[int, int, bytes]
"""(log time, publish time, bytes); times in nanoseconds."""


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
    pa = _arrow()
    tables = [
        pa.Table.from_batches([batch]) for batch in arrow_batches(decoder, messages, fields=fields, notice=notice)
    ]
    try:
        return pa.concat_tables(tables, promote_options="permissive")
    except pa.ArrowException:  # batches of JSON whose values changed their types
        from kleinkram.recordings.decoding.json_rows import joined

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
        from kleinkram.recordings.decoding.json_rows import JsonRows

        return JsonRows(decoder, fields, notice)
    from kleinkram.recordings.decoding.typed_rows import TypedRows

    return TypedRows(decoder, decoder.struct, columns_of(decoder.struct, fields), notice)


def _raw_rows(log_ns: list[int], publish_ns: list[int], data: list[bytes]) -> Any:
    import pyarrow as pa

    return timed_batch(log_ns, publish_ns, ["data"], [pa.array([bytes(raw) for raw in data], pa.binary())])
