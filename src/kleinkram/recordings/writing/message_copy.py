"""Copies the messages of a recording to a file that is written, re-encoded where that is wanted.

Messages that the output cannot hold are left out, counted and named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from kleinkram.recordings.decoding import DecodeError, Decoder, Undecodable, decoder_for
from kleinkram.recordings.decoding.msg_definitions import well_known_definitions
from kleinkram.recordings.decoding.ros_versions import ReEncoding, to_ros1, to_ros2
from kleinkram.recordings.decoding.transcode import Transcode
from kleinkram.recordings.decoding.types import SchemaError
from kleinkram.recordings.errors import NotConvertible
from kleinkram.recordings.messages import Channel, RawMessage, Schema
from kleinkram.recordings.model import counted

if TYPE_CHECKING:
    from kleinkram.recordings.recording import OnProgress, Recording

_PROGRESS_MESSAGES = 1000
_SEPARATOR = "=" * 80


class Route(NamedTuple):
    """Where messages of a channel go. `number`: of the channel in the output; `transcode`: None where bytes stay."""

    number: int
    transcode: Transcode | None = None


@dataclass(frozen=True)
class LeftOut:
    """Messages of a topic that are not in the output. `reason`: a sentence; of the first one, should they differ."""

    topic: str
    message_count: int
    reason: str


Define = Callable[[Channel, bytes], Route]
"""Defines a channel of the output by one of the source and its first message; `SchemaError` if it cannot be there."""

Add = Callable[[int, RawMessage, bytes], None]
"""Adds a message with these bytes to a channel of the output; `DecodeError` if it cannot be there."""


class MessageCopy:
    """Copies messages, once. `message_count` and `left_out` are complete after `copy` and `define_silent`."""

    def __init__(self, define: Define, add: Add) -> None:
        self._define, self._add = define, add
        self._routes: dict[int, Route | None] = {}
        self._left_out: dict[str, tuple[int, str]] = {}
        self.message_count = 0

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """What is left out, by topic."""
        return tuple(LeftOut(topic, *item) for topic, item in sorted(self._left_out.items()))

    def copy(self, messages: Iterable[RawMessage], on_log_time: Callable[[int], None]) -> None:
        """Copy all messages; `on_log_time` gets the log time of some."""
        routes, add, count = self._routes, self._add, 0
        for number, message in enumerate(messages, 1):
            channel, data = message.channel, message.data
            route = routes[id(channel)] if id(channel) in routes else self._route(channel, data)
            if route is None:
                self._leave_out(channel.topic, 1)
            else:
                try:
                    add(route.number, message, data if route.transcode is None else route.transcode(data))
                    count += 1
                except DecodeError as error:
                    self._leave_out(channel.topic, 1, str(error))
            if number % _PROGRESS_MESSAGES == 0:
                on_log_time(message.log_time_ns)
        self.message_count += count

    def define_silent(self, channels: Iterable[Channel]) -> None:
        """Define the channels that have no messages."""
        for channel in channels:
            if id(channel) not in self._routes:
                self._route(channel, b"")

    def check_any(self, name: str, what: str) -> None:
        """Raise `NotConvertible` if messages were left out, and none was copied."""
        if not self.message_count:
            for part in self.left_out:
                if part.message_count:
                    raise NotConvertible(name, f"{what}: {part.reason}")

    def _route(self, channel: Channel, data: bytes) -> Route | None:
        try:
            route = self._define(channel, data)
        except SchemaError as error:
            self._leave_out(channel.topic, 0, str(error))
            route = None
        self._routes[id(channel)] = route
        return route

    def _leave_out(self, topic: str, count: int, reason: str = "") -> None:
        so_far, first_reason = self._left_out.get(topic, (0, reason))
        self._left_out[topic] = so_far + count, first_reason


def channels_of(recordings: Iterable[Recording]) -> Iterator[Channel]:
    """Yield the channels of recordings, in the order of their files."""
    for recording in recordings:
        for member in recording.members:
            yield from member.contents.channels.values()


def share_reporter(start_ns: int, end_ns: int, on_progress: OnProgress | None) -> Callable[[int], None]:
    """Return what reports the share of a time range that is done, by the log time of a message."""
    span_ns = max(1, end_ns - start_ns)

    def report(log_ns: int) -> None:
        if on_progress is not None:
            on_progress(min(1.0, max(0.0, (log_ns - start_ns) / span_ns)))

    return report


def with_definition(schema: Schema, message_encoding: str, data: bytes) -> Schema:
    """Return the schema with the definition of its type, where the recording has none and the type is well known.

    `data`: a message, by which one of several definitions is chosen.
    """
    if schema.encoding or schema.data.strip() or message_encoding != "cdr":
        return schema
    texts = [text.replace("===\n", f"{_SEPARATOR}\n") for text in well_known_definitions(schema.name)]
    fitting = [text for text in texts if data and _is_readable(schema.name, text, data)]
    return Schema(schema.name, "ros2msg", (fitting or texts)[0].encode()) if texts else schema


def _is_readable(type_name: str, definition: str, data: bytes) -> bool:
    decoder = decoder_for("cdr", type_name, "ros2msg", definition.encode())
    try:
        return isinstance(decoder, Decoder) and decoder.decode(data) is not None
    except DecodeError:
        return False


def re_encoding_of(channel: Channel, schema: Schema) -> ReEncoding:
    """Return how messages of a channel become those of the other version of ROS.

    Raises:
        SchemaError: they cannot, with the reason.
    """
    decoder = decoder_for(channel.message_encoding, schema.name, schema.encoding, schema.data)
    if isinstance(decoder, Undecodable):
        raise SchemaError(decoder.reason)
    if channel.message_encoding == "ros1":
        return to_ros2(schema.name, schema.data)
    return to_ros1(schema.name, schema.encoding, schema.data)


def sentences(left_out: Iterable[LeftOut]) -> Iterator[str]:
    """Yield a sentence for each topic of which messages are left out."""
    for part in left_out:
        yield f"{part.topic}: {counted(part.message_count, 'message')} left out: {part.reason}"
