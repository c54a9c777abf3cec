"""Writes topics of a recording as Parquet files, one row group a batch, in the memory of a batch."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kleinkram.recordings.decoding.tables import load_pyarrow
from kleinkram.recordings.errors import CannotWrite
from kleinkram.recordings.messages import Topic
from kleinkram.recordings.writing.new_file import new_file

if TYPE_CHECKING:
    from kleinkram.recordings.recording import OnProgress, Recording

_FRAME = "header.frame_id"
_UNSAFE = re.compile(r"[^\w.-]+", re.ASCII)
_MAX_NAME = 200
_BATCH_BYTES = 4 * 2**20
_VARYING = ("json", "protobuf")
"""Encodings whose batches have the columns that their messages need."""


@dataclass(frozen=True)
class ParquetFile:
    """The file of a topic."""

    topic: str
    path: Path
    row_count: int
    size_bytes: int


@dataclass(frozen=True)
class ParquetResult:
    """The written files by topic, and why other topics were left out."""

    files: tuple[ParquetFile, ...]
    left_out: dict[str, str]


def write_parquet(
    recording: Recording, folder: Path, topics: tuple[Topic, ...], on_progress: OnProgress | None
) -> ParquetResult:
    """Write topics as `Recording.to_parquet` describes."""
    pa = load_pyarrow()
    files: list[ParquetFile] = []
    left_out: dict[str, str] = {}
    names = _names_of(topics)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotWrite(str(folder), f"the folder cannot be made: {error.strerror}") from error
    for number, topic in enumerate(topics, 1):
        if topic.undecodable is not None:
            left_out[topic.name] = topic.undecodable
        else:
            try:
                files.append(_write_topic(recording, topic, folder / names[topic.name]))
            except pa.ArrowException as error:
                left_out[topic.name] = f"its columns do not fit into Parquet: {error}"
        if on_progress is not None:
            on_progress(number / len(topics))
    return ParquetResult(tuple(files), left_out)


def _names_of(topics: tuple[Topic, ...]) -> dict[str, str]:
    """Return the name of the file of each topic; they differ also where case does not count."""
    names: dict[str, str] = {}
    taken: set[str] = set()
    for topic in topics:
        stem = _UNSAFE.sub("_", topic.name.strip("/").replace("/", "."))[:_MAX_NAME].lstrip(".") or "topic"
        name, number = stem, 1
        while name.lower() in taken:
            number += 1
            name = f"{stem}-{number}"
        taken.add(name.lower())
        names[topic.name] = f"{name}.parquet"
    return names


def _write_topic(recording: Recording, topic: Topic, path: Path) -> ParquetFile:
    import pyarrow.parquet as pq

    schema = _common_schema(recording, topic) if topic.message_encoding in _VARYING else None
    frames: set[str | None] = set()
    row_count, writer = 0, None
    with new_file(path) as stream:
        with ExitStack() as stack:
            for table in _tables(recording, topic, schema):
                if writer is None:
                    texts = _texts_of(table.schema)
                    options = {"compression": "zstd", "use_dictionary": texts}
                    writer = stack.enter_context(pq.ParquetWriter(stream, table.schema, **options))
                row_count += table.num_rows
                _note_frames(table, frames)
                writer.write_table(table)
                del table  # before the next one is made
            if writer is not None:
                writer.add_key_value_metadata(_metadata_of(recording, topic, frames))
        size_bytes = stream.tell()
    return ParquetFile(topic.name, path, row_count, size_bytes)


def _texts_of(schema: Any) -> list[str]:
    """Return the columns of texts, which often repeat; dictionaries of other columns would take memory for nothing."""
    import pyarrow as pa

    return [field.name for field in schema if pa.types.is_string(field.type)]


def _common_schema(recording: Recording, topic: Topic) -> Any:
    """Return a schema with the columns of all batches of a topic."""
    import pyarrow as pa

    schemas = (batch.schema for batch in recording.batches(topic.name, batch_bytes=_BATCH_BYTES))
    return functools.reduce(lambda one, other: pa.unify_schemas([one, other], promote_options="permissive"), schemas)


def _tables(recording: Recording, topic: Topic, schema: Any | None) -> Iterator[Any]:
    """Yield the rows of a topic as tables; with a schema, with all of its columns."""
    import pyarrow as pa

    for batch in recording.batches(topic.name, batch_bytes=_BATCH_BYTES):
        table = pa.Table.from_batches([batch])
        del batch
        if schema is not None and not table.schema.equals(schema):
            table = pa.concat_tables([schema.empty_table(), table], promote_options="permissive")
        yield table
        del table


def _note_frames(table: Any, frames: set[str | None]) -> None:
    if len(frames) < 2 and _FRAME in table.column_names:  # two are as good as many
        frames.update(table[_FRAME].unique().to_pylist())


def _metadata_of(recording: Recording, topic: Topic, frames: set[str | None]) -> dict[str, str]:
    metadata = {
        "recording": Path(recording.name).name,
        "topic": topic.name,
        "message_type": topic.message_type,
        "message_encoding": topic.message_encoding,
    }
    frame = frames.pop() if len(frames) == 1 else None
    return metadata if frame is None else {**metadata, "frame_id": frame}
