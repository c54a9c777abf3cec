"""Recordings as `mcap`, `rosbags` and SQLite read them."""

from __future__ import annotations

import re
import sqlite3
import tempfile
from collections.abc import Callable, Collection, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from mcap.stream_reader import StreamReader
from rosbags.rosbag1 import Reader as BagReader
from rosbags.typesys import Stores, get_typestore

from tests.recording_files.plain_values import plain, rosbags_decoder

Stamped = tuple[str, int, bytes]
"""Topic, log time, data."""

Values = list[tuple[str, int, str]]
"""Topic, log time, and the text of the decoded message."""


_BYTE = re.compile(r"^byte\b", re.MULTILINE)


class MessageType(NamedTuple):
    """What a file says of the messages of a topic; `definition`: None where it has none."""

    encoding: str
    name: str
    definition_kind: str
    definition: str | None


@dataclass(frozen=True)
class IndependentRecording:
    """Messages by log time, and the types of their topics; where a topic has several, the last."""

    messages: list[Stamped]
    types: Mapping[str, MessageType]


def decoder_of(kind: MessageType) -> Callable[[bytes], Any]:
    """Return what decodes messages with `rosbags`, by their definition, or by its own where there is none."""
    if kind.definition is not None and "/srv/" in kind.name:
        return rosbags_decoder(kind.encoding, kind.name.replace("/srv/", "/msg/"), _of_service(kind))
    if kind.definition is not None and kind.definition_kind in ("ros1msg", "ros2msg"):
        # `rosbags` reads the bytes of ROS 2 as signed; they are unsigned.
        unsigned = _BYTE.sub("uint8", kind.definition) if kind.encoding == "cdr" else kind.definition
        return rosbags_decoder(kind.encoding, kind.name, unsigned)
    store = get_typestore(Stores.ROS2_HUMBLE)
    return lambda data: plain(store.deserialize_cdr(data, kind.name))


def _of_service(kind: MessageType) -> str:
    """Return the definition of the events of a service; `rosbag2` stores that of the service instead.

    Source: ROS 2, service_msgs/msg/ServiceEventInfo.msg and rosidl_parser, `SERVICE_EVENT_MESSAGE_SUFFIX`.
    """
    service = kind.name.rpartition("/")[2].removesuffix("_Event")
    request, _, response = (kind.definition or "").partition("---\n")
    rule = "=" * 80
    return f"""service_msgs/ServiceEventInfo info
{service}_Request[<=1] request
{service}_Response[<=1] response
{rule}
MSG: service_msgs/ServiceEventInfo
uint8 event_type
builtin_interfaces/Time stamp
char[16] client_gid
int64 sequence_number
{rule}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{rule}
MSG: {kind.name.partition("/")[0]}/{service}_Request
{request}
{rule}
MSG: {kind.name.partition("/")[0]}/{service}_Response
{response}"""


def values_of(recording: IndependentRecording, without: Collection[str] = ()) -> Values:
    """Return the values of all messages, except those of some topics."""
    decoders = {topic: decoder_of(kind) for topic, kind in recording.types.items() if topic not in without}
    return [
        (topic, log_ns, repr(decoders[topic](data))) for topic, log_ns, data in recording.messages if topic in decoders
    ]


@cache
def independent_recording(path: Path) -> IndependentRecording:
    """Return what is in a file that does not change; it is read once."""
    return read_recording(path)


@cache
def independent_values(path: Path) -> Values:
    """Return the values of all messages of a file that does not change."""
    return values_of(independent_recording(path))


def read_recording(path: Path) -> IndependentRecording:
    """Return what is in a file."""
    read = {".bag": _read_bag, ".db3": _read_database, ".zstd": _read_packed}.get(path.suffix, _read_mcap)
    return read(path)


def _read_packed(path: Path) -> IndependentRecording:
    with tempfile.TemporaryDirectory() as folder:
        unpacked = Path(folder) / path.stem
        with path.open("rb") as source, unpacked.open("wb") as target:
            zstandard.ZstdDecompressor().copy_stream(source, target)
        return read_recording(unpacked)


def _read_bag(path: Path) -> IndependentRecording:
    with BagReader(path) as reader:
        types = {one.topic: MessageType("ros1", one.msgtype, "ros1msg", one.msgdef.data) for one in reader.connections}
        messages = [(connection.topic, stamp, bytes(data)) for connection, stamp, data in reader.messages()]
    return IndependentRecording(messages, types)


def _read_database(path: Path) -> IndependentRecording:
    with closing(sqlite3.connect(path)) as database:
        messages = database.execute(
            "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id "
            "ORDER BY timestamp, messages.id"
        ).fetchall()
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
        columns = "topic_type, encoding, encoded_message_definition"
        stored = (
            database.execute(f"SELECT {columns} FROM message_definitions") if "message_definitions" in tables else ()
        )  # our words
        definitions = {name: (kind, text) for name, kind, text in stored}
        topics = database.execute("SELECT name, type FROM topics").fetchall()
    types = {topic: MessageType("cdr", kind, *definitions.get(kind, ("", None))) for topic, kind in topics}
    return IndependentRecording(messages, types)


def _read_mcap(path: Path) -> IndependentRecording:
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    messages: list[Stamped] = []
    with path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            kind, one = type(record).__name__, record
            if kind == "Schema":
                schemas[one.id] = one  # type: ignore[attr-defined]  # by its name
            elif kind == "Channel":
                channels[one.id] = one  # type: ignore[attr-defined]
            elif kind == "Message":
                messages.append((channels[one.channel_id].topic, one.log_time, one.data))  # type: ignore[attr-defined]
    types = {}
    for channel in channels.values():
        schema = schemas.get(channel.schema_id)
        own = ("", "", None) if schema is None else (schema.name, schema.encoding, schema.data.decode(errors="replace"))
        types[channel.topic] = MessageType(channel.message_encoding, *own)
    return IndependentRecording(sorted(messages, key=lambda message: message[1]), types)
