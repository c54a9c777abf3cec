"""Writes a recording of ROS messages as one ROS 1 bag.

Memory: the messages that are being merged, and what `BagWriter` holds.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.decoding.ros_versions import ros1_md5sum
from kleinkram.recordings.decoding.types import SchemaError
from kleinkram.recordings.messages import Channel, RawMessage
from kleinkram.recordings.writing.bag_writer import BagWriter, ros_lz4
from kleinkram.recordings.writing.chunked_writer import COMPRESSION_THREADS
from kleinkram.recordings.writing.latched import publisher_count
from kleinkram.recordings.writing.losses import MemberLoss, find_losses
from kleinkram.recordings.writing.message_copy import (
    LeftOut,
    MessageCopy,
    Route,
    channels_of,
    re_encoding_of,
    share_reporter,
    with_definition,
)
from kleinkram.recordings.writing.new_file import new_file

if TYPE_CHECKING:
    from kleinkram.recordings.recording import OnProgress, Recording, Topics

_END_OF_TIME_NS = 2**32 * 1_000_000_000


class BagCompression(str, Enum):
    """Compression of the chunks of a bag."""

    lz4 = "lz4"
    bz2 = "bz2"
    none = "none"


_COMPRESS: dict[BagCompression, Callable[[bytes], bytes]] = {
    BagCompression.lz4: ros_lz4,
    BagCompression.bz2: bz2.compress,
    BagCompression.none: bytes,
}


@dataclass(frozen=True)
class BagOptions:
    """How a bag is written. `chunk_bytes`: uncompressed bytes of messages after which a chunk ends."""

    compression: BagCompression = BagCompression.lz4
    chunk_bytes: int = 768 * 1024

    def __post_init__(self) -> None:
        if self.chunk_bytes < 1:
            raise ValueError(f"chunks of {self.chunk_bytes} bytes cannot be written")


@dataclass(frozen=True)
class BagResult:
    """A written bag.

    Attributes:
        losses: what of the recording could not be read; empty if nothing was lost.
        left_out: messages that a bag cannot hold.
    """

    path: Path
    message_count: int
    size_bytes: int
    losses: tuple[MemberLoss, ...]
    left_out: tuple[LeftOut, ...]


def write_bag(
    recording: Recording, path: Path, topics: Topics | None, options: BagOptions, on_progress: OnProgress | None
) -> BagResult:
    """Write a recording as `Recording.to_bag` describes."""
    selected = frozenset(topic.name for topic in recording.select_topics(topics))
    with new_file(path) as stream:
        writer = BagWriter(
            stream,
            compression=options.compression.value,
            compress=bag_compressor(options),
            chunk_bytes=options.chunk_bytes,
            workers=COMPRESSION_THREADS,
        )
        with closing(writer):
            copy = MessageCopy(_Connections(writer).define, _adder(writer))
            report = share_reporter(recording.start_ns or 0, recording.end_ns or 0, on_progress)
            copy.copy(recording.raw_messages(topics), report)
            copy.define_silent(one for one in channels_of([recording]) if one.topic in selected)
            copy.check_any(recording.name, "no message of it can be in a bag")
            writer.finish()
        losses = find_losses(recording)
        recording.check_unchanged()
    return BagResult(path, copy.message_count, writer.bytes_written, losses, copy.left_out)


def bag_compressor(options: BagOptions) -> Callable[[bytes], bytes]:
    """Return what compresses chunks, in several threads at once."""
    return _COMPRESS[options.compression]


def _adder(writer: BagWriter) -> Callable[[int, RawMessage, bytes], None]:
    def add(number: int, message: RawMessage, data: bytes) -> None:
        if not 0 <= message.log_time_ns < _END_OF_TIME_NS:
            raise DecodeError(message.schema.name, f"the log time {message.log_time_ns} ns is beyond those of a bag")
        writer.add_message(number, message.log_time_ns, data)

    return add


class _Connections:
    """The connections of the output. Equal channels of several files become one."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self._routes: dict[Channel, Route] = {}

    def define(self, channel: Channel, data: bytes) -> Route:
        """Return the connection of a channel; `data`: its first message."""
        if channel not in self._routes:
            self._routes[channel] = self._new(channel, data)
        return self._routes[channel]

    def _new(self, channel: Channel, data: bytes) -> Route:
        schema, add = channel.schema, self._writer.add_connection
        if channel.message_encoding == "ros1":
            md5sum = dict(channel.properties).get("md5sum") or ros1_md5sum(schema.name, schema.data)
            text = schema.data.decode("utf-8", "replace")
            return Route(add(channel.topic, schema.name, md5sum=md5sum, definition=text, properties=channel.properties))
        if channel.message_encoding != "cdr":
            raise SchemaError(f"messages in '{channel.message_encoding}' are none of ROS")
        made = re_encoding_of(channel, with_definition(schema, "cdr", data))
        latching = (("latching", "1"),) if publisher_count(channel) else ()
        number = add(channel.topic, made.name, md5sum=made.md5sum, definition=made.definition, properties=latching)
        return Route(number, made.transcode)
