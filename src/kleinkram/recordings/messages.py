"""Messages, channels, topics and selections."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass
from typing import Any, NamedTuple

END_OF_TIME_NS = 2**64  # behind every log time that a file can hold


@dataclass(frozen=True)
class Schema:
    """A message type, as the file defines it.

    Attributes:
        encoding: how `data` is written: "ros1msg", "ros2msg", "ros2idl", "protobuf", "jsonschema"; empty: none.
        data: the definition itself; empty where the file holds none (rosbag2 databases before Iron).
    """

    name: str
    encoding: str
    data: bytes


Properties = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Channel:
    """A topic as one publisher wrote it.

    Attributes:
        message_encoding: how messages are written: "ros1", "cdr", "json", "protobuf".
        message_compression: "zstd" where rosbag2 compressed each message separately; messages are read decompressed.
        properties: name and value of others, as the metadata of an MCAP channel: "offered_qos_profiles" and
            "topic_type_hash" of rosbag2; "callerid", "latching" and "md5sum" of ROS 1.
    """

    topic: str
    message_encoding: str
    schema: Schema
    message_compression: str = ""
    properties: Properties = ()


class RawMessage(NamedTuple):
    """An undecoded message.

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
        """The schema of its channel."""
        return self.channel.schema


Block = list[RawMessage]


class Message(NamedTuple):
    """A decoded message. Times as in `RawMessage`.

    Attributes:
        value: what `kleinkram.recordings.decoding` makes of it; the bytes where its schema cannot be decoded. Its
            attributes are those of the message's definition, unknown to type checkers.
    """

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    value: Any  # Any: the file defines its fields
    channel: Channel

    @property
    def schema(self) -> Schema:
        """The schema of its channel."""
        return self.channel.schema

    @property
    def stamp_ns(self) -> int | None:
        """When it was measured, in ns: the stamp in its header, or its own; None without one."""
        from kleinkram.recordings.decoding import DecodeError, stamp_ns  # only for decoded messages

        try:
            return stamp_ns(self.value)
        except DecodeError:
            return None


@dataclass(frozen=True)
class Topic:
    """A topic of a recording, over all its files.

    Attributes:
        message_type: name of its type; of the first channel, should they differ.
        count: messages; None where they would have to be read to be counted.
        undecodable: why its messages stay bytes; None where they can be decoded.
    """

    name: str
    message_type: str
    schema: Schema
    message_encoding: str
    count: int | None
    undecodable: str | None


class Selection(NamedTuple):
    """start <= log time < end, and topics (None: all)."""

    topics: frozenset[str] | None = None
    start_ns: int = 0
    end_ns: int = END_OF_TIME_NS

    def has_topic(self, topic: str) -> bool:
        """Return whether a topic is selected."""
        return self.topics is None or topic in self.topics

    @property
    def has_range(self) -> bool:
        """Whether a time range is selected, rather than all times."""
        return (self.start_ns, self.end_ns) != (0, END_OF_TIME_NS)


_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)
_MICROSECOND = datetime.timedelta(microseconds=1)
_ISO = re.compile(r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d)(?::(\d\d)(?:\.(\d{1,9}))?)?)?\s?(Z|[+-]\d\d:?\d\d)?", re.ASCII)

Time = int | str | datetime.datetime
"""Nanoseconds since 1970 (UTC), an aware datetime (pandas' too), or ISO 8601 text, in UTC unless it has a zone."""


def to_ns(time: Time) -> int:
    """Return nanoseconds since 1970.

    Raises:
        ValueError: a datetime without time zone, or a text that is not a time.
        TypeError: it is not a `Time`.
    """
    if isinstance(time, str):
        return _read(time)
    if isinstance(time, datetime.datetime):
        if time.tzinfo is None:
            raise ValueError(f"{time} has no time zone; give one, such as datetime.timezone.utc")
        beyond = int(getattr(time, "nanosecond", 0))  # pandas' own, which a datetime lacks
        return (time - _EPOCH) // _MICROSECOND * 1000 + beyond
    try:
        return time.__index__()  # numpy's integers, too
    except AttributeError:
        raise TypeError(f"{time!r} is no time: give nanoseconds since 1970, an aware datetime, or ISO text") from None


def _read(text: str) -> int:
    wrong = ValueError(f"{text!r} is no time; write it like 2026-05-01T10:00:00Z")
    if (match := _ISO.fullmatch(text.strip())) is None:
        raise wrong
    try:
        day, minute, second, fraction, zone = match.groups()
        offset = "+00:00" if zone in (None, "Z") else zone if ":" in zone else f"{zone[:3]}:{zone[3:]}"
        at = datetime.datetime.fromisoformat(f"{day}T{minute or '00:00'}:{second or '00'}{offset}")
    except ValueError:
        raise wrong from None
    return (at - _EPOCH) // _MICROSECOND * 1000 + int((fraction or "0").ljust(9, "0"))
