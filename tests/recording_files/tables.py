"""Recordings of JSON messages, and the rows of Parquet files as `Recording.to_arrow` has them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from tests.recording_files.builders import T0
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import McapWriter


def json_mcap(values: Iterable[object], *, name: str = "State") -> MemorySource:
    """Return an MCAP with one JSON message of a type each nanosecond, on /state."""
    out = BytesIO()
    writer = McapWriter(out)
    channel = writer.add_channel("/state", writer.add_schema(name, "jsonschema", b"{}"), "json")
    for number, value in enumerate(values):
        writer.add_message(channel, T0 + number, json.dumps(value).encode())
    writer.finish()
    return MemorySource(out.getvalue())


def as_arrow(path: Path) -> pa.Table:
    """Return the rows of a file with the columns of `to_arrow`: times as integers."""
    table = pq.read_table(path)
    names, columns = [], []
    for field, column in zip(table.schema, table.columns, strict=True):
        is_time = pa.types.is_timestamp(field.type)
        names.append(f"{field.name}_ns" if is_time else field.name)
        columns.append(column.cast(pa.int64()) if is_time else column)
    return pa.Table.from_arrays(columns, names=names)
