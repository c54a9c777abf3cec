"""Writes topics of a recording as Parquet files, one row group a batch, in the memory of a batch."""

from __future__ import annotations

import re
from collections.abc import Iterator
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

    schema = _common_schema(recording, topic)
    frames: set[str | None] = set()
    row_count = 0
    with new_file(path) as stream:
        with pq.ParquetWriter(stream, schema, compression="zstd") as writer:
            for batch in _batches(recording, topic, schema):
                row_count += batch.num_rows
                _note_frames(batch, frames)
                writer.write_table(batch)
            writer.add_key_value_metadata(_metadata_of(recording, topic, frames))
        size_bytes = stream.tell()
    return ParquetFile(topic.name, path, row_count, size_bytes)


def _common_schema(recording: Recording, topic: Topic) -> Any:
    """Return the schema of all batches of a topic, by reading them where they may differ."""
    import pyarrow as pa

    batches = recording.batches(topic.name)
    schema = next(batches).schema
    if topic.message_encoding in _VARYING:
        for batch in batches:
            schema = pa.unify_schemas([schema, batch.schema], promote_options="permissive")
    return schema


def _batches(recording: Recording, topic: Topic, schema: Any) -> Iterator[Any]:
    """Yield the rows of a topic as tables with all columns of the schema."""
    import pyarrow as pa

    empty = schema.empty_table()
    for batch in recording.batches(topic.name):
        table = pa.Table.from_batches([batch])
        yield table if table.schema.equals(schema) else pa.concat_tables([empty, table], promote_options="permissive")


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
