"""Makes the preview of a recording in one pass over its messages.

Bounded whatever the recording: topics, fields, pictures and lines are counted, and a recording that is larger than
`PreviewLimits.whole_bytes` is read in parts that are evenly spread over it.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kleinkram.recordings.decoding.sensor_data import CAMERA_TYPES, VIDEO_TYPES
from kleinkram.recordings.errors import TooDisordered
from kleinkram.recordings.formats.base import Segment
from kleinkram.recordings.messages import Block, Selection, Topic
from kleinkram.recordings.previews.bins import FieldBudget
from kleinkram.recordings.previews.clouds import CLOUD_TYPES
from kleinkram.recordings.previews.log_lines import LOG_TYPES, LogLines
from kleinkram.recordings.previews.model import LeftOutTopic, RecordingPreview
from kleinkram.recordings.previews.size_limit import encode_within
from kleinkram.recordings.previews.topic_readers import (
    CameraReader,
    CloudReader,
    LogReader,
    NumericTopicReader,
    TopicReader,
)
from kleinkram.recordings.recording import Recording, merged_blocks
from kleinkram.recordings.trajectories.topics import POSE_TYPES

MAX_BYTES, MIN_BYTES = 20 * 10**6, 256 * 10**3
MAX_TOPICS, MAX_CAMERAS, MAX_CLOUD_TOPICS = 500, 16, 4
MAX_SERIES = 1_000  # fields of all topics: each takes up to 64 kB
MAX_LEFT_OUT = 100
MAX_READ_SPANS = 4_000  # as many as a topic has bins
_MAX_TIME_NS = 2**63 - 1
# What a message that no reader expected may raise.
_UNEXPECTED = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


@dataclass(frozen=True)
class PreviewLimits:
    """Bounds of a preview.

    Attributes:
        max_bytes: of its file; None: `preview_max_bytes` of the recording.
        whole_bytes: a larger recording is read in parts.
        cpu_s: processor time, in seconds, after which no more is read.
        wall_s: time on the clock, in seconds, after which no more is read.
    """

    max_bytes: int | None = None
    whole_bytes: int = 4 * 2**30
    cpu_s: float = 240.0
    wall_s: float = math.inf


def preview_max_bytes(recording_bytes: int) -> int:
    """Return the greatest size of a preview: 1 % of the recording, but at least 256 kB, and at most 20 MB."""
    return min(MAX_BYTES, max(MIN_BYTES, recording_bytes // 100))


def make_preview(recording: Recording, limits: PreviewLimits | None = None) -> bytes:
    """Read a recording, and return the file of its preview. The content of a recording never raises.

    Raises:
        ReadingExtraMissing: pillow is not installed.
        SourceError: the bytes cannot be read.
    """
    limits = limits or PreviewLimits()
    builder = _PreviewBuilder(recording.topics)
    parts = builder.read(recording, limits)
    return encode_within(builder.preview(parts), limits.max_bytes or preview_max_bytes(recording.size_bytes))


@dataclass(frozen=True, eq=False)
class ReadParts:
    """What was read of a recording: its share, and `RecordingPreview.read_spans`."""

    share: float
    spans: NDArray[np.int64]


_WHOLE = ReadParts(1.0, np.empty((0, 2), np.int64))


class _PreviewBuilder:
    def __init__(self, topics: Iterable[Topic]) -> None:
        self._logs = LogLines()
        self._numbers: list[NumericTopicReader] = []
        self._cameras: list[CameraReader] = []
        self._clouds: list[CloudReader] = []
        self._readers: dict[str, TopicReader] = {}
        self._left_out: list[LeftOutTopic] = []
        self._budget = FieldBudget(MAX_SERIES)
        self._start_ns: int | None = None
        self._end_ns: int | None = None
        for topic in topics:
            if topic.count != 0:
                self._plan(topic)

    def _plan(self, topic: Topic) -> None:
        kind = topic.message_type.replace(".", "/").rpartition("/")[2]
        if topic.undecodable is not None:
            self._leave_out(topic, topic.undecodable)
        elif kind in VIDEO_TYPES:
            self._leave_out(topic, "parts of a video are no pictures by themselves")
        elif kind in CAMERA_TYPES:
            if len(self._cameras) < MAX_CAMERAS:
                self._cameras.append(CameraReader(topic))
                self._readers[topic.name] = self._cameras[-1]
            else:
                self._leave_out(topic, f"{MAX_CAMERAS} other cameras are shown")
        elif kind in CLOUD_TYPES:
            if len(self._clouds) < MAX_CLOUD_TOPICS:
                self._clouds.append(CloudReader(topic))
                self._readers[topic.name] = self._clouds[-1]
            else:
                self._leave_out(topic, f"{MAX_CLOUD_TOPICS} other topics of clouds are shown")
        elif kind in LOG_TYPES:
            self._readers[topic.name] = LogReader(self._logs)
        elif len(self._numbers) < MAX_TOPICS:
            self._numbers.append(NumericTopicReader(topic, self._budget, is_pose=kind in POSE_TYPES))
            self._readers[topic.name] = self._numbers[-1]
        else:
            self._leave_out(topic, f"{MAX_TOPICS} other topics are shown")

    def _leave_out(self, topic: Topic, reason: str) -> None:
        if len(self._left_out) < MAX_LEFT_OUT:
            self._left_out.append(LeftOutTopic(topic.name, reason[:200]))

    def read(self, recording: Recording, limits: PreviewLimits) -> ReadParts:
        """Read the messages; return what was read of the recording."""
        if not self._readers:
            return _WHOLE
        parts = _Parts(recording, frozenset(self._readers), limits)
        try:
            with contextlib.suppress(TooDisordered):
                self._add_until(limits, parts.blocks())
        finally:
            for topic in list(self._readers):
                self._finish(topic)
        return parts.read()

    def _add_until(self, limits: PreviewLimits, blocks: Iterable[Block]) -> None:
        until_cpu_s, until_s = time.process_time() + limits.cpu_s, time.monotonic() + limits.wall_s
        for block in blocks:
            self._add(block)
            if time.process_time() > until_cpu_s or time.monotonic() > until_s:
                return

    def _add(self, block: Block) -> None:
        readers = self._readers
        for topic, log_ns, _publish_ns, _sequence, data, channel in block:
            if topic in readers:
                try:
                    readers[topic].add(log_ns, data, channel)
                except _UNEXPECTED as error:
                    self._drop(topic, error)
        if block:
            first_ns, last_ns = block[0].log_time_ns, block[-1].log_time_ns
            self._start_ns = first_ns if self._start_ns is None else min(self._start_ns, first_ns)
            self._end_ns = last_ns if self._end_ns is None else max(self._end_ns, last_ns)

    def _finish(self, topic: str) -> None:
        try:
            self._readers[topic].finish()
        except _UNEXPECTED as error:
            self._drop(topic, error)

    def _drop(self, topic: str, error: Exception) -> None:
        """Leave out a topic whose messages cannot be processed; the others stay."""
        reader = self._readers.pop(topic)
        self._numbers = [one for one in self._numbers if one is not reader]
        self._cameras = [one for one in self._cameras if one is not reader]
        self._clouds = [one for one in self._clouds if one is not reader]
        if len(self._left_out) < MAX_LEFT_OUT:
            self._left_out.append(LeftOutTopic(topic, f"its messages cannot be shown ({type(error).__name__})"))

    def preview(self, parts: ReadParts) -> RecordingPreview:
        """Return what was collected."""
        left_out = list(self._left_out)
        for numbers in self._numbers:
            if numbers.why_left_out and len(left_out) < MAX_LEFT_OUT:
                left_out.append(LeftOutTopic(numbers.topic.name, numbers.why_left_out))
        return RecordingPreview(
            self._start_ns,
            self._end_ns,
            parts.share,
            tuple(series for numbers in self._numbers if (series := numbers.series()) is not None),
            tuple(strip for camera in self._cameras if (strip := camera.strip()) is not None),
            tuple(track for numbers in self._numbers if (track := numbers.track()) is not None),
            self._logs.lines(),
            self._logs.count,
            tuple(cloud for reader in self._clouds for cloud in reader.clouds()),
            tuple(left_out),
            parts.spans,
        )


class _Parts:
    """What is read of a recording: all, or of a large one, segments that are spread evenly."""

    def __init__(self, recording: Recording, topics: frozenset[str], limits: PreviewLimits) -> None:
        self._share = 1.0
        self._recording, self._topics = recording, topics
        self._segments: list[Segment] | None = None
        self._places: list[int] = []
        self._done_share = 0.0  # of what is read at all
        self._spans: list[tuple[int, int]] = []  # of the segments that were read, the last one maybe in part
        if recording.size_bytes > limits.whole_bytes:
            segments = recording.segments(sorted(topics))
            step = max(1.0, sum(segment.size_bytes for segment in segments) / limits.whole_bytes)
            self._places = [int(number * step) for number in range(int(len(segments) / step))]
            self._segments = [segments[place] for place in self._places]
            self._share = 1 / step

    def read(self) -> ReadParts:
        """Return what was read until now."""
        runs: list[tuple[int, int]] = []
        for number, (first_ns, last_ns) in enumerate(self._spans):
            if number and self._places[number] == self._places[number - 1] + 1:  # nothing lies between the two
                runs[-1] = min(runs[-1][0], first_ns), max(runs[-1][1], last_ns)
            else:
                runs.append((first_ns, last_ns))
        return ReadParts(self._done_share * self._share, joined_spans(runs))

    def blocks(self) -> Iterator[Block]:
        """Yield messages by time."""
        if self._segments is None:
            for block in merged_blocks([self._recording], Selection(self._topics)):
                if block:
                    self._done_share = _share_of_time(self._recording, block[-1].log_time_ns)
                yield block
        else:
            for number, segment in enumerate(self._segments):
                for block in self._recording.segment_messages(segment, sorted(self._topics)):
                    if block:
                        self._note(number, segment, block[-1].log_time_ns)
                    yield block
                self._note(number, segment, segment.last_ns)
        self._done_share = 1.0

    def _note(self, number: int, segment: Segment, time_ns: int) -> None:
        """Note that a segment, the last one that was begun, was read until a time."""
        until_ns = max(segment.first_ns, min(time_ns, segment.last_ns))
        self._spans[number:] = [(segment.first_ns, until_ns)]
        length_ns = segment.last_ns - segment.first_ns
        share = (until_ns - segment.first_ns) / length_ns if length_ns > 0 else 1.0
        self._done_share = (number + share) / len(self._places)


def _share_of_time(recording: Recording, time_ns: int) -> float:
    start_ns, end_ns = recording.start_ns, recording.end_ns
    if start_ns is None or end_ns is None or end_ns <= start_ns:
        return 0.0
    return min(1.0, max(0.0, (time_ns - start_ns) / (end_ns - start_ns)))


def joined_spans(spans: Iterable[tuple[int, int]], most: int = MAX_READ_SPANS) -> NDArray[np.int64]:
    """Return spans of time in order, those that touch as one; of more than `most`, neighbours are joined, too."""
    joined: list[tuple[int, int]] = []
    for first_ns, last_ns in sorted(spans):
        if joined and first_ns <= joined[-1][1] + 1:
            joined[-1] = joined[-1][0], max(joined[-1][1], last_ns)
        else:
            joined.append((first_ns, last_ns))
    while len(joined) > most:
        joined = [(pair[0][0], pair[-1][1]) for pair in (joined[at : at + 2] for at in range(0, len(joined), 2))]
    bounded = [[min(max(time_ns, -_MAX_TIME_NS), _MAX_TIME_NS) for time_ns in span] for span in joined]
    return np.array(bounded, np.int64).reshape(-1, 2)
