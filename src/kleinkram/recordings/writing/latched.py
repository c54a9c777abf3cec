"""Messages of latched topics that are valid when a slice of a recording starts.

A subscriber that joins late receives the last message of each publisher of a latched (ROS 1) or transient-local (ROS 2)
topic: the map, the robot description, static transforms. A slice begins with these messages. Their log time is the
start of the slice, because players wait between log times, and would otherwise be silent until the slice begins; their
publish time stays that of the original, in formats without one its log time.

Memory: the messages that are returned. Of a file with an index, at most `_MAX_SEGMENTS` chunks of a topic are read.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import chain
from operator import itemgetter

from kleinkram.recordings.chunk_reader import ChunkedMember
from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.formats.base import Segment
from kleinkram.recordings.messages import Channel, RawMessage
from kleinkram.recordings.recording import Recording, decode

_TRANSIENT_LOCAL = re.compile(r"\bdurability\"?:\s*(1|transient_local)\b", re.IGNORECASE)
_LATCHED_NAMES = ("tf_static", "robot_description")
"""Last parts of topics that are latched wherever they are published, also where a file has no QoS profiles."""

_STATIC_TRANSFORMS = "tf_static"
_MAX_SEGMENTS = 64


def publisher_count(channel: Channel) -> int:
    """Return how many publishers of a channel are latched; 0 for a topic that is not.

    Source: rosbag2 stores the offered QoS profile of each publisher of a topic, with `durability: 1` or
    `transient_local`; a bag has a connection for each publisher, with `latching=1`.
    """
    properties = dict(channel.properties)
    profiles = len(_TRANSIENT_LOCAL.findall(properties.get("offered_qos_profiles", "")))
    is_latched = properties.get("latching") == "1" or channel.topic.rpartition("/")[2] in _LATCHED_NAMES
    return profiles or int(is_latched)


def latched_before(recording: Recording, topics: frozenset[str] | None, start_ns: int) -> list[RawMessage]:
    """Return the valid messages of latched topics before a log time, by log time; of equal times, as in the files.

    Of each channel, the last message of as many as there are publishers; of static transforms, the last message for
    each child frame, since several publishers share the topic. In a file with more than 64 chunks that hold a topic,
    the first and the last 32 of them are read.
    """
    latched = _latched_topics(recording, topics)
    if not latched or (recording.start_ns is not None and recording.start_ns >= start_ns):
        return []
    collectors = {topic: _new_collector(topic, channels) for topic, channels in latched.items()}
    if all(isinstance(member, ChunkedMember) for member in recording.members):
        segments = [segment for segment in recording.segments([*collectors]) if segment.first_ns < start_ns]
        _read_backwards(recording, segments, collectors, start_ns)
    else:
        _collect(collectors, recording.raw_messages([*collectors], end=start_ns), (0, 0))
    placed = (item for one in collectors.values() for item in one.messages())
    return [message for _, message in sorted(placed, key=_place)]


def _latched_topics(recording: Recording, topics: frozenset[str] | None) -> dict[str, set[Channel]]:
    """Return the channels of each selected topic that has a latched publisher."""
    channels: dict[str, set[Channel]] = {}
    for member in recording.members:
        for channel in member.contents.channels.values():
            if topics is None or channel.topic in topics:
                channels.setdefault(channel.topic, set()).add(channel)
    return {topic: some for topic, some in channels.items() if any(map(publisher_count, some))}


_Place = tuple[int, tuple[int, int], int]  # log time; order of the segment; number in it
_Placed = tuple[_Place, RawMessage]
_place = itemgetter(0)


class _LastMessages:
    """The last messages of each channel of a topic."""

    def __init__(self, channels: Collection[Channel]) -> None:
        self._count = max(map(publisher_count, channels))
        self._channel_count = len(channels)
        self._by_channel: dict[Channel, list[_Placed]] = {}

    def add(self, place: _Place, message: RawMessage) -> None:
        last = self._by_channel.setdefault(message.channel, [])
        last.append((place, message))
        last.sort(key=_place)
        del last[: -self._count]

    def is_complete(self, last_ns: int) -> bool:
        """Return whether messages up to a log time cannot be among the last ones."""
        return len(self._by_channel) == self._channel_count and all(
            len(last) == self._count and last[0][1].log_time_ns >= last_ns for last in self._by_channel.values()
        )

    def messages(self) -> Iterable[_Placed]:
        return (item for last in self._by_channel.values() for item in last)


class _LastTransforms:
    """The last message for each child frame."""

    def __init__(self) -> None:
        self._by_frame: dict[str, _Placed] = {}

    def add(self, place: _Place, message: RawMessage) -> None:
        for frame in _child_frames(message):
            if frame not in self._by_frame or self._by_frame[frame][0] < place:
                self._by_frame[frame] = place, message

    def is_complete(self, last_ns: int) -> bool:
        """Return False: any earlier message may have another frame."""
        return False

    def messages(self) -> Iterable[_Placed]:
        return dict(self._by_frame.values()).items()


_Collector = _LastMessages | _LastTransforms


def _new_collector(topic: str, channels: Collection[Channel]) -> _Collector:
    return _LastTransforms() if topic.rpartition("/")[2] == _STATIC_TRANSFORMS else _LastMessages(channels)


def _child_frames(message: RawMessage) -> Iterator[str]:
    """Yield the child frames of transforms; of a message that cannot be decoded, one name that only it has."""
    try:
        value = decode(message)
        transforms = getattr(value, "transforms", None)
        yield from ([str(transform.child_frame_id) for transform in transforms] if transforms is not None else [""])
    except (AttributeError, TypeError, DecodeError):  # another type than static transforms have
        yield ""


def _read_backwards(
    recording: Recording, segments: Sequence[Segment], collectors: dict[str, _Collector], start_ns: int
) -> None:
    """Read the segments in which the last messages may be, the latest first."""
    latest_first = sorted(segments, key=lambda segment: (segment.last_ns, segment.order), reverse=True)
    to_read = {topic: _orders(latest_first, topic) for topic in collectors}
    for segment in latest_first:
        topics = [
            topic
            for topic, one in collectors.items()
            if segment.order in to_read[topic] and not one.is_complete(segment.last_ns)
        ]
        if topics:
            messages = chain.from_iterable(recording.segment_messages(segment, topics))
            _collect(collectors, (message for message in messages if message.log_time_ns < start_ns), segment.order)


def _orders(segments: Sequence[Segment], topic: str) -> Collection[tuple[int, int]]:
    """Return the orders of the segments that are read for a topic: where it was first and last published."""
    orders = [segment.order for segment in segments if segment.topics is None or topic in segment.topics]
    half = _MAX_SEGMENTS // 2
    return frozenset(orders if len(orders) <= _MAX_SEGMENTS else orders[:half] + orders[-half:])


def _collect(collectors: dict[str, _Collector], messages: Iterable[RawMessage], segment_order: tuple[int, int]) -> None:
    for number, message in enumerate(messages):
        collectors[message.topic].add((message.log_time_ns, segment_order, number), message)
