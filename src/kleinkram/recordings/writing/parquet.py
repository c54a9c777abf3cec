"""Writes a topic as a Parquet file, one row group a batch, in the memory of a batch.

The columns are those of `to_arrow`, except that times (not durations) are timestamps in ns, UTC: `log_time`,
`publish_time`, `header.stamp`. The file's metadata say what it was made from; a column's `unit` is in the metadata of
its field, and in `units` of the file, for readers that are not Arrow.
"""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from kleinkram import __version__
from kleinkram.recordings.decoding.tables import TIME_COLUMNS, columns_of, is_time
from kleinkram.recordings.messages import Selection
from kleinkram.recordings.writing.new_file import new_file
from kleinkram.recordings.writing.topic_rows import (
    FrameNames,
    OnRows,
    TopicGroup,
    Written,
    rows_of,
    schema_of,
    sources_of,
    unused_name,
)


def write_parquet(group: TopicGroup, path: Path, selection: Selection, on_rows: OnRows) -> Written:
    """Write the rows of a topic to a new file.

    Raises:
        CannotWrite: the file exists, or its folder cannot be written to or is full.
        pyarrow.ArrowException: the columns do not fit into Parquet, or contradict each other.
    """
    import pyarrow.parquet as pq

    schema = schema_of(group, selection)
    frames = FrameNames()
    row_count, writer = 0, None
    with new_file(path) as stream:
        with ExitStack() as stack:
            for rows in rows_of(group, schema, selection):
                table = _with_timestamps(rows, group)
                if writer is None:
                    options = {"compression": "zstd", "use_dictionary": _texts_of(table.schema)}
                    writer = stack.enter_context(pq.ParquetWriter(stream, table.schema, **options))
                frames.note(table)
                writer.write_table(table)
                row_count += table.num_rows
                on_rows(table.num_rows)
                del rows, table  # before the next ones are made
            if writer is not None:
                writer.add_key_value_metadata(_metadata_of(group, frames.only))
        size_bytes = stream.tell()
    return Written(row_count, size_bytes, frames.only)


def _texts_of(schema: Any) -> list[str]:
    """Return the columns of texts, which often repeat; dictionaries of other columns would take memory for nothing."""
    import pyarrow as pa

    return [field.name for field in schema if pa.types.is_string(field.type)]


def _with_timestamps(table: Any, group: TopicGroup) -> Any:
    """Return rows whose times are timestamps, with a unit for each column that has one."""
    import pyarrow as pa

    moments, units = _moments_of(group), column_units(group)
    names: list[str] = []
    fields, columns = [], []
    for field, column in zip(table.schema, table.columns, strict=True):
        name, kind, unit = field.name, field.type, units.get(field.name)
        if name in moments:
            name, kind = name.removesuffix("_ns"), pa.timestamp("ns", "UTC")
        names.append(unused_name(name, names))
        fields.append(pa.field(names[-1], kind, metadata=None if unit is None else {"unit": unit}))
        columns.append(column.cast(kind))
    return pa.Table.from_arrays(columns, schema=pa.schema(fields))


def _moments_of(group: TopicGroup) -> set[str]:
    """Return the columns that are points in time: also fields of ROS types, but no durations."""
    columns = [] if group.struct is None else columns_of(group.struct, None)
    own = {column.name for column in columns if is_time(column.kind) and not _is_duration(column.kind)}
    return own | set(TIME_COLUMNS)


def _is_duration(kind: Any) -> bool:
    return str(kind.name).lower().endswith("duration")


def _metadata_of(group: TopicGroup, frame_id: str | None) -> dict[str, str]:
    metadata = {
        "topic": group.topic.name,
        "message_type": group.topic.message_type,
        "message_encoding": group.topic.message_encoding,
        "sources": json.dumps(sources_of(group.recordings), ensure_ascii=False),
        "units": json.dumps(column_units(group), ensure_ascii=False),
        "kleinkram": __version__,
    }
    return metadata if frame_id is None else {**metadata, "frame_id": frame_id}


def column_units(group: TopicGroup) -> dict[str, str]:
    """Return the units of the columns; timestamps have none, as their type is one."""
    moments = _moments_of(group)
    return {name: unit for name, unit in group.units().items() if name not in moments}
