"""ROS messages from plain values, and small recordings of them in memory or as files."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from kleinkram.recordings.decoding.msg_definitions import Ros, parse_msg
from kleinkram.recordings.decoding.types import Array, Struct, Type
from kleinkram.recordings.sample import messages as definitions
from kleinkram.recordings.sample.messages import Encoding
from kleinkram.recordings.sample.writers import Db3Writer
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import BagWriter, McapWriter

T0 = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


class TimedMessage(NamedTuple):
    """A message to be recorded. `values`: of its fields; others are 0 or empty. `stamp_ns`: of its header."""

    topic: str
    message_type: str
    log_ns: int
    values: Mapping[str, Any]
    stamp_ns: int | None = None


def encode(message_type: str, values: Mapping[str, Any], encoding: Encoding = Encoding.cdr) -> bytes:
    """Return a serialised message; `message_type` such as "sensor_msgs/Imu"."""
    out = bytearray(definitions.CDR_LITTLE_ENDIAN if encoding is Encoding.cdr else b"")
    _Writer(out, encoding).write(_struct(message_type, encoding), values)
    return bytes(out)


@cache
def _struct(message_type: str, encoding: Encoding) -> Struct:
    if encoding is Encoding.ros1:
        return parse_msg(message_type, definitions.ros1_definition(message_type), Ros.one)
    return parse_msg(definitions.ros2_name(message_type), definitions.ros2_definition(message_type), Ros.two)


class _Writer:
    def __init__(self, out: bytearray, encoding: Encoding) -> None:
        self._out, self._is_cdr = out, encoding is Encoding.cdr

    def write(self, kind: Type, value: Any) -> None:
        if isinstance(kind, Struct):
            for field in kind.fields:
                self.write(field.type, None if value is None else value.get(field.name))
        elif isinstance(kind, Array):
            self._array(kind, value)
        elif not kind.code:
            text = (value or "").encode() + (b"\0" if self._is_cdr else b"")
            self._number("I", 4, len(text))
            self._out += text
        else:
            self._number(kind.code, kind.size, value or 0)

    def _array(self, kind: Array, value: Any) -> None:
        items = value if value is not None else [None] * (kind.length or 0)
        if kind.length is None:
            self._number("I", 4, len(items))
        if isinstance(items, bytes):
            self._out += items
            return
        for item in items:
            self.write(kind.element, item)

    def _number(self, code: str, size: int, value: float) -> None:
        if self._is_cdr:
            self._out += bytes(-(len(self._out) - 4) % size)
        self._out += struct.pack(f"<{code}", value)


def data_of(message: TimedMessage, encoding: Encoding) -> bytes:
    """Return a serialised message with its stamp."""
    if message.stamp_ns is None:
        return encode(message.message_type, message.values, encoding)
    seconds, rest = divmod(message.stamp_ns, SECOND)
    stamp = {"secs": seconds, "nsecs": rest} if encoding is Encoding.ros1 else {"sec": seconds, "nanosec": rest}
    header = {"frame_id": "sensor", **message.values.get("header", {}), "stamp": stamp}
    return encode(message.message_type, {**message.values, "header": header}, encoding)


def ros2_mcap(timed: Iterable[TimedMessage], *, chunk_bytes: int = 2**16, name: str = "test.mcap") -> MemorySource:
    """Return an MCAP of ROS 2 messages."""
    out = BytesIO()
    writer = McapWriter(out, profile="ros2", chunk_bytes=chunk_bytes)
    channels: dict[str, int] = {}
    for message in timed:
        if message.topic not in channels:
            definition = definitions.ros2_definition(message.message_type).encode()
            schema = writer.add_schema(definitions.ros2_name(message.message_type), "ros2msg", definition)
            channels[message.topic] = writer.add_channel(message.topic, schema, "cdr")
        writer.add_message(channels[message.topic], message.log_ns, data_of(message, Encoding.cdr))
    writer.finish()
    return MemorySource(out.getvalue(), name)


def ros1_bag(timed: Iterable[TimedMessage], *, chunk_bytes: int = 2**16, name: str = "test.bag") -> MemorySource:
    """Return a ROS 1 bag."""
    out = BytesIO()
    writer = BagWriter(out, chunk_bytes=chunk_bytes)
    connections: dict[str, int] = {}
    for message in timed:
        kind = message.message_type
        if message.topic not in connections:
            connections[message.topic] = writer.add_connection(
                message.topic, kind, md5sum=definitions.ros1_md5(kind), definition=definitions.ros1_definition(kind)
            )
        writer.add_message(connections[message.topic], message.log_ns, data_of(message, Encoding.ros1))
    writer.finish()
    return MemorySource(out.getvalue(), name)


def ros2_db3(timed: Iterable[TimedMessage], folder: Path) -> Path:
    """Write a rosbag2 database with its folder; return the folder."""
    writer = Db3Writer(folder)
    topics: dict[str, int] = {}
    for message in timed:
        if message.topic not in topics:
            topics[message.topic] = writer.add_topic(message.topic, definitions.ros2_name(message.message_type))
        writer.add_message(topics[message.topic], message.log_ns, data_of(message, Encoding.cdr))
    writer.finish()
    return folder
