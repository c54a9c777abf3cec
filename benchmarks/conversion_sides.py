"""Sides that convert a recording to MCAP, each run as a process of its own (see `side`): ours and public pairs."""

import time
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag1 import Reader
from small_mcap import McapWriter, read_message

from benchmarks.side import Facts, main
from kleinkram.recordings import Recording


def convert_ours(source: str, target: str) -> Facts:
    """Write a recording of any format as MCAP."""
    started = time.perf_counter()
    with Recording.open(source) as recording:
        result = recording.to_mcap(target)
    return {"seconds": time.perf_counter() - started, "messages": result.message_count, "bytes": result.size_bytes}


def convert_rosbags(source: str, target: str) -> Facts:
    """A bag, read with rosbags and written with mcap."""
    started = time.perf_counter()
    count = 0
    with Reader(source) as reader, Path(target).open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros1")
        channels = {}
        for connection in reader.connections:
            schema = writer.register_schema(connection.msgtype, "ros1msg", connection.msgdef.data.encode())
            channels[connection.id] = writer.register_channel(connection.topic, "ros1", schema)
        for connection, stamp, data in reader.messages():
            writer.add_message(channels[connection.id], stamp, bytes(data), stamp)
            count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return _facts(started, count, target)


def convert_mcap(source: str, target: str) -> Facts:
    """An MCAP, read and written with mcap."""
    started = time.perf_counter()
    count = 0
    with Path(source).open("rb") as file, Path(target).open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.id not in channels and schema is not None:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
            count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return _facts(started, count, target)


def convert_rosbags_small(source: str, target: str) -> Facts:
    """A bag, read with rosbags and written with small-mcap."""
    started = time.perf_counter()
    count = 0
    with Reader(source) as reader, Path(target).open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros1")
        for number, connection in enumerate(reader.connections, 1):
            writer.add_schema(number, connection.msgtype, "ros1msg", connection.msgdef.data.encode())
            writer.add_channel(connection.id, connection.topic, "ros1", number)
        for connection, stamp, data in reader.messages():
            writer.add_message(connection.id, stamp, bytes(data), stamp)
            count += 1
        writer.finish()
    return _facts(started, count, target)


def convert_small_mcap(source: str, target: str) -> Facts:
    """An MCAP, read and written with small-mcap, with every checksum."""
    started = time.perf_counter()
    count = 0
    with Path(source).open("rb") as file, Path(target).open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2")
        channels: set[int] = set()
        for schema, channel, message in read_message(file, validate_crc=True):
            if channel.id not in channels and schema is not None:
                channels.add(channel.id)
                writer.add_schema(schema.id, schema.name, schema.encoding, schema.data)
                writer.add_channel(channel.id, channel.topic, channel.message_encoding, schema.id)
            writer.add_message(channel.id, message.log_time, message.data, message.publish_time)
            count += 1
        writer.finish()
    return _facts(started, count, target)


def _facts(started: float, messages: int, target: str) -> Facts:
    return {
        "seconds": time.perf_counter() - started,
        "messages": messages,
        "bytes": Path(target).stat().st_size,
    }


if __name__ == "__main__":
    main((convert_ours, convert_rosbags, convert_rosbags_small, convert_mcap, convert_small_mcap))
