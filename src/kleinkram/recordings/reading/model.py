"""The nouns of reading: channels, messages, topics, and what was asked for. Values only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

# Names of seconds and nanoseconds: of ROS 2, ROS 1, Foxglove's JSON, and protobuf.
_STAMPS = (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"), ("seconds", "nanos"))
END_OF_TIME_NS = 2**64
"""Behind every log time that a file can hold."""


@dataclass(frozen=True)
class Schema:
    """What a message type looks like, as the file says.

    Attributes:
        encoding: how `data` is written: "ros1msg", "ros2msg", "ros2idl", "protobuf", "jsonschema"; empty: none.
        data: the definition itself; empty where the file holds none (rosbag2 databases before Iron).
    """

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class Channel:
    """A topic as one publisher wrote it into one file.

    Attributes:
        message_encoding: how messages are written: "ros1", "cdr", "json", "protobuf".
        message_compression: "zstd" where rosbag2 compressed each message by itself; already undone in what is read.
    """

    topic: str
    message_encoding: str
    schema: Schema
    message_compression: str = ""


class RawMessage(NamedTuple):
    """One message as its bytes.

    Attributes:
        log_time_ns: when it was recorded, nanoseconds of the log clock.
        publish_time_ns: when it was sent; only MCAP keeps it, elsewhere the log time.
        sequence: a number that its publisher gave; only MCAP keeps it, elsewhere 0.
    """

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes
    channel: Channel

    @property
    def schema(self) -> Schema:
        """What its type looks like."""
        return self.channel.schema


class Message(NamedTuple):
    """One message as values. Times as in `RawMessage`.

    Attributes:
        value: what `kleinkram.recordings.decoding` makes of it; the bytes where its schema cannot be decoded. Its
            attributes are those of the message's definition, which no type checker knows.
    """

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    value: Any  # Any: what fields it has, the file says
    channel: Channel

    @property
    def schema(self) -> Schema:
        """What its type looks like."""
        return self.channel.schema

    @property
    def stamp_ns(self) -> int | None:
        """When it was measured, in ns: its header's stamp, or its own, of ROS 1 and ROS 2 alike; None without one."""
        header = _field(self.value, "header")
        for stamp in (_field(header, "stamp"), _field(self.value, "stamp"), _field(self.value, "timestamp")):
            for seconds, nanoseconds in _STAMPS:
                whole, rest = _field(stamp, seconds), _field(stamp, nanoseconds)
                if isinstance(whole, int) and isinstance(rest, int):
                    return whole * 1_000_000_000 + rest
        return None


@dataclass(frozen=True)
class Topic:
    """One topic of a recording, over all its files.

    Attributes:
        message_type: name of its type; of the first channel, should they differ.
        count: messages; None where only reading all of them would tell.
        undecodable: why its messages stay bytes; None where they can be decoded.
    """

    name: str
    message_type: str
    schema: Schema
    message_encoding: str
    count: int | None
    undecodable: str | None


class Selection(NamedTuple):
    """What is wanted: start <= log time < end, and channels by their topics (None: all)."""

    topics: frozenset[str] | None = None
    start_ns: int = 0
    end_ns: int = END_OF_TIME_NS


def _field(value: object, name: str) -> object:
    """Return a field of a decoded message, or of one that JSON made; None where it has none of that name."""
    return value.get(name) if isinstance(value, dict) else getattr(value, name, None)
