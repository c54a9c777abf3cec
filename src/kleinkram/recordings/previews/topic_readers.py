"""Readers of topics: series and tracks, thumbnails, clouds, and log lines. The content of a message never raises."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from kleinkram.recordings.decoding import DecodeError, Decoder
from kleinkram.recordings.messages import Channel, Topic
from kleinkram.recordings.previews.bins import BinnedFields, FieldBudget
from kleinkram.recordings.previews.clouds import thinned_cloud
from kleinkram.recordings.previews.columns import NumericColumns
from kleinkram.recordings.previews.log_lines import LogLines
from kleinkram.recordings.previews.model import CameraStrip, PositionTrack, ThinnedCloud, Thumbnail, TopicSeries
from kleinkram.recordings.previews.samples import EvenSamples
from kleinkram.recordings.previews.thumbnails import thumbnail
from kleinkram.recordings.previews.tracks import PositionSampler
from kleinkram.recordings.recording import decoder_of

MAX_THUMBNAILS, MAX_CLOUDS = 60, 7  # of one topic
_LARGE_MESSAGE_BYTES = 32 * 1024  # a larger one is a map, a mesh or the like, and its numbers are no series
_BATCH_MESSAGES, _BATCH_BYTES = 1024, 128 * 1024
_MAX_DECODED_LOGS = 100_000  # of one topic
_MAX_TIME_NS = 2**63 - 1


class TopicReader(Protocol):
    """Reads the messages of one topic."""

    def add(self, time_ns: int, data: bytes, channel: Channel) -> None:
        """Add a message; its content never raises."""

    def finish(self) -> None:
        """Process what waits for others."""


class _ChannelDecoders:
    """The decoders of a topic's channels."""

    def __init__(self) -> None:
        self._decoders: dict[int, tuple[Channel, Decoder | None]] = {}

    def find(self, channel: Channel) -> Decoder | None:
        """Return the decoder of a channel; None if its messages cannot be decoded."""
        known = self._decoders.get(id(channel))
        if known is None:
            decoder = decoder_of(channel.message_encoding, channel.schema)
            known = self._decoders[id(channel)] = channel, decoder if isinstance(decoder, Decoder) else None
        return known[1]

    def decode(self, data: bytes, channel: Channel) -> object | None:
        """Return a decoded message; None if that is not possible."""
        decoder = self.find(channel)
        try:
            return None if decoder is None else decoder.decode(data)
        except DecodeError:
            return None


class NumericTopicReader:
    """Series and track of a topic. Messages are read in batches."""

    def __init__(self, topic: Topic, budget: FieldBudget, *, is_pose: bool) -> None:
        self.topic = topic
        self._decoders = _ChannelDecoders()
        self._columns: dict[int, NumericColumns] = {}
        self._bins = BinnedFields(budget)
        self._positions = PositionSampler(topic.name, is_pose=is_pose)
        self._channel: Channel | None = None
        self._times_ns: list[int] = []
        self._data: list[bytes] = []
        self._size_bytes = 0
        self._large = 0

    def add(self, time_ns: int, data: bytes, channel: Channel) -> None:
        """Add a message; its content never raises."""
        if len(data) > _LARGE_MESSAGE_BYTES or time_ns > _MAX_TIME_NS:
            self._large += 1
            return
        if channel is not self._channel or len(self._data) >= _BATCH_MESSAGES or self._size_bytes > _BATCH_BYTES:
            self.finish()
            self._channel = channel
        self._times_ns.append(time_ns)
        self._data.append(data)
        self._size_bytes += len(data)

    def finish(self) -> None:
        """Process the messages that wait for others."""
        channel, data, times_ns = self._channel, self._data, np.array(self._times_ns, np.int64)
        self._times_ns, self._data, self._size_bytes = [], [], 0
        decoder = None if channel is None else self._decoders.find(channel)
        if decoder is None or not data:
            return
        columns = self._columns.setdefault(id(channel), NumericColumns(decoder)).read(data)
        self._positions.add(times_ns, columns)
        self._bins.add(times_ns, columns)

    @property
    def why_left_out(self) -> str | None:
        """Why something of the topic is left out."""
        if self._large:
            return f"{self._large} messages are larger than {_LARGE_MESSAGE_BYTES} bytes"
        if self._bins.left_out_fields:
            return "it has more fields than are shown"
        return None

    def series(self) -> TopicSeries | None:
        """Return the series; None without numbers."""
        is_sampled = any(columns.is_sampled for columns in self._columns.values())
        series = self._bins.series(self.topic.name, self.topic.message_type, is_sampled=is_sampled)
        return series if series.fields else None

    def track(self) -> PositionTrack | None:
        """Return the track; None if there is none."""
        return self._positions.track()


class CameraReader:
    """Thumbnails of a topic. Pictures that cannot be decoded are left out."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._decoders = _ChannelDecoders()
        self._samples: EvenSamples[Thumbnail] = EvenSamples(MAX_THUMBNAILS, topic.count)

    def add(self, time_ns: int, data: bytes, channel: Channel) -> None:
        """Add a message; its content never raises."""
        if not self._samples.takes_next():
            return
        value = self._decoders.decode(data, channel)
        if value is None:
            return
        try:
            self._samples.add(thumbnail(value, time_ns))
        except (DecodeError, MemoryError):
            return

    def finish(self) -> None:
        """Do nothing: no message waits."""

    def strip(self) -> CameraStrip | None:
        """Return the thumbnails; None without any."""
        items = self._samples.items
        return CameraStrip(self._topic.name, self._samples.count, tuple(items)) if items else None


class CloudReader:
    """Some clouds of a topic."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._decoders = _ChannelDecoders()
        self._samples: EvenSamples[ThinnedCloud] = EvenSamples(MAX_CLOUDS, topic.count)

    def add(self, time_ns: int, data: bytes, channel: Channel) -> None:
        """Add a message; its content never raises."""
        if not self._samples.takes_next():
            return
        value = self._decoders.decode(data, channel)
        if value is None:
            return
        try:
            self._samples.add(thinned_cloud(value, self._topic.name, time_ns))
        except (DecodeError, MemoryError):
            return

    def finish(self) -> None:
        """Do nothing: no message waits."""

    def clouds(self) -> list[ThinnedCloud]:
        """Return the clouds by time."""
        return self._samples.items


class LogReader:
    """Lines of a topic."""

    def __init__(self, logs: LogLines) -> None:
        self._logs = logs
        self._decoders = _ChannelDecoders()
        self._decoded = 0

    def add(self, time_ns: int, data: bytes, channel: Channel) -> None:
        """Add a message; its content never raises."""
        self._decoded += 1
        if self._decoded > _MAX_DECODED_LOGS:
            return
        value = self._decoders.decode(data, channel)
        if value is not None:
            self._logs.add(channel.topic, time_ns, value)

    def finish(self) -> None:
        """Do nothing: no message waits."""
