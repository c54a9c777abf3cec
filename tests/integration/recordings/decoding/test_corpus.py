"""Every message of every real recording that can be decoded is what an independent reader says."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kleinkram.recordings.decoding import DecodeError, Decoder, decoder_for, to_arrow
from kleinkram.recordings.decoding.values import Value
from tests.recording_files.corpus import Entry, entries, params

OURS_ONLY = ("test_msgs/srv/BasicTypes_Event", "example_interfaces/srv/AddTwoInts_Event")
"""Services' schemas hold requests and responses; no other reader makes the event of them."""
DEFINED_DB3 = ("ros2-db3/all_types_94_topics/test_bag_sqlite3.db3", "ros2-db3/event_camera/test_events_1.db3")
ZSTD = b"\x28\xb5\x2f\xfd"
TIME_NAMES = {"secs": "sec", "nsecs": "nanosec"}


class Raw(NamedTuple):
    """One message with all that decoding it takes."""

    message_encoding: str
    name: str
    schema_encoding: str
    schema: bytes
    data: bytes


def check(messages: Iterator[Raw]) -> int:
    """Compare both readers on all messages that ours decodes; returns how many those are."""
    count = 0
    for raw in messages:
        message_decoder = decoder_for(*raw[:4])
        if not isinstance(message_decoder, Decoder):
            continue
        ours = message_decoder.decode(raw.data)
        count += 1
        if raw.name not in OURS_ONLY and isinstance(ours, Value):
            assert differs(ours, other_decoder(*raw[:4])(raw.data)) is None, raw.name
    return count


@cache
def other_decoder(message_encoding: str, name: str, schema_encoding: str, schema: bytes) -> Callable[[bytes], Any]:
    if message_encoding == "ros1":
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(schema.decode(), name))
        full_name = name.replace("/", "/msg/")
        return lambda data: store.deserialize_ros1(data, full_name)
    decode = DecoderFactory().decoder_for("cdr", Schema(id=1, name=name, encoding=schema_encoding, data=schema))
    assert decode is not None
    return decode


def differs(ours: Any, theirs: Any) -> str | None:
    """Return where two values differ; None where they do not."""
    if isinstance(ours, Value):
        for name in ours._fields:
            other = getattr(theirs, TIME_NAMES.get(name, name) if len(ours._fields) == 2 else name, None)
            inside = differs(getattr(ours, name), getattr(theirs, name.rstrip("_")) if other is None else other)
            if inside is not None:
                return f".{name}{inside}"
        return None
    if isinstance(ours, np.ndarray):
        other = np.frombuffer(theirs, np.uint8) if isinstance(theirs, (bytes, memoryview)) else np.asarray(theirs)
        same = ours.shape == other.shape and np.array_equal(ours, other, equal_nan=ours.dtype.kind == "f")
        return None if same else f": {ours!r:.200} is not {theirs!r:.200}"
    if isinstance(ours, list):
        if len(ours) != len(theirs):
            return f": {len(ours)} elements, not {len(theirs)}"
        return next((where for one, other in zip(ours, theirs, strict=True) if (where := differs(one, other))), None)
    same = ours == theirs or (isinstance(ours, float) and math.isnan(ours) and math.isnan(theirs))
    return None if same else f": {ours!r:.200} is not {theirs!r:.200}"


def mcap_messages(path: Path) -> Iterator[Raw]:
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            data = message.data
            if data.startswith(ZSTD):
                data = zstandard.decompress(data)
            if schema is not None:
                yield Raw(channel.message_encoding, schema.name, schema.encoding, schema.data, data)


def bag_messages(path: Path) -> Iterator[Raw]:
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            name = connection.msgtype.replace("/msg/", "/")
            yield Raw("ros1", name, "ros1msg", connection.msgdef.data.encode(), data)


def db3_messages(path: Path) -> Iterator[Raw]:
    with closing(sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)) as connection:
        definitions = dict(connection.execute("SELECT topic_type, encoded_message_definition FROM message_definitions"))
        rows = connection.execute("SELECT type, data FROM messages JOIN topics ON topics.id = topic_id")
        for name, data in rows:
            yield Raw("cdr", name, "ros2msg", definitions[name].encode(), data)


# The messages of the conformance set are no messages of any encoding.
DECODABLE = [param for param in params("MCAP") if not str(param.id).startswith("conformance/")]


@pytest.mark.parametrize("entry", DECODABLE)
def test_mcap(entry: Entry, recordings_dir: Path) -> None:
    assert check(mcap_messages(recordings_dir / entry.name)) == entry.expected["messages"]


@pytest.mark.parametrize("entry", params("ROS1 bag 2.0"))
def test_bag(entry: Entry, recordings_dir: Path) -> None:
    assert check(bag_messages(recordings_dir / entry.name)) == entry.expected["messages"]


@pytest.mark.parametrize("name", DEFINED_DB3)
def test_db3(name: str, recordings_dir: Path) -> None:
    (entry,) = (entry for entry in entries() if entry.name == name)
    assert check(db3_messages(recordings_dir / name)) == entry.expected["messages"]


def fail(log_time_ns: int, error: DecodeError) -> None:
    """Stop where a message has no row."""
    raise AssertionError(f"message of {log_time_ns}") from error


@pytest.mark.parametrize("name", ["mcap/SO_bag/SO_bag_0.mcap", "mcap/rosbag2_all_sensor_msgs_none.mcap"])
def test_every_topic_becomes_a_table(name: str, recordings_dir: Path) -> None:
    topics: dict[tuple[str, str, str, bytes], list[bytes]] = {}
    for raw in mcap_messages(recordings_dir / name):
        topics.setdefault(raw[:4], []).append(raw.data)
    for key, messages in topics.items():
        message_decoder = decoder_for(*key)
        table = to_arrow(message_decoder, ((1, 2, data) for data in messages), notice=fail)
        table.validate(full=True)
        assert table.num_rows == len(messages)
