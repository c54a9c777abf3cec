"""Reads samples of one recording and passes them to the probes of their topics.

Reads the segments of a plan, one at a time and each once for all topics; holds one segment in memory.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

from kleinkram.checks.content.probe import RecordedTopic, SampledMessage, SampleSink
from kleinkram.checks.content.segment_plan import SegmentVisit, nearest, plan_visits, plan_whole
from kleinkram.recordings import RecordingError
from kleinkram.recordings.formats.base import Segment
from kleinkram.recordings.messages import RawMessage
from kleinkram.recordings.recording import Recording

_NOT_AMONG_SAMPLES = "none of its messages is in the parts that were read"
_UNKNOWN_END_NS = 2**63 - 1
_PAGE_BYTES, _MAX_SEARCH_BYTES = 4096, 2**30
_SMALL_MESSAGE_BYTES = 200
_AROUND = 250  # messages before and behind the samples of a topic in one segment that are measured, too


class SampleReader:
    """The segments of one recording that hold topics to be checked.

    `samples`: how many messages are needed of each topic; `pair_gap_ns`: as in `plan_visits`.
    """

    def __init__(self, name: str, recording: Recording, samples: Mapping[str, int], pair_gap_ns: int) -> None:
        self.name = name
        self._recording = recording
        self._samples = samples
        self._pair_gap_ns = pair_gap_ns
        self._segments: list[Segment] = []
        self._failure = ""
        self._damaged: dict[str, str] = {}
        self._is_whole = False
        self._counts: dict[str, int] = defaultdict(int)
        try:
            self._segments = recording.segments(list(samples))
        except RecordingError as error:
            self._failure = str(error)

    @property
    def size_bytes(self) -> int:
        """Bytes of all segments that hold one of the topics."""
        return sum(segment.size_bytes for segment in self._segments)

    @property
    def message_count(self) -> int:
        """Number of messages of the topics, as far as the index says; an estimate where it does not."""
        counts = [self._recording.topic(topic).count for topic in self._samples]
        if None not in counts:
            return sum(count or 0 for count in counts)
        return self._recording.message_count or self.size_bytes // _SMALL_MESSAGE_BYTES

    def read(self, probes: Mapping[str, Sequence[SampleSink]], budget_bytes: int | None) -> None:
        """Read samples and pass them to the probes of their topics. `budget_bytes`: None to read all messages."""
        self._is_whole = budget_bytes is None
        if budget_bytes is None:
            visits = plan_whole(self._segments, self._samples)
        else:
            visits = plan_visits(self._segments, self._samples, self._pair_gap_ns, budget_bytes)
        for visit in visits:
            self._read_visit(visit, list(self._samples), probes)
        missing = [topic for topic in self._samples if not self._counts[topic]]
        if missing and any(visit.segment.topics is None for visit in visits):
            self._search(missing, probes)
        for topic in self._damaged:
            self._note_damage(topic, probes[topic])
        for topic in missing:
            if not self._counts[topic]:
                reason = self._failure or ("" if self._recording.topic(topic).count == 0 else _NOT_AMONG_SAMPLES)
                for probe in probes[topic]:
                    probe.note_unread(reason or "it has no messages")

    def read_near(self, topic: str, times_ns: Iterable[int], probe: SampleSink) -> None:
        """Read the segments of a topic that are nearest to some log times, for one probe."""
        numbers = [n for n, part in enumerate(self._segments) if part.topics is None or topic in part.topics]
        visits: dict[int, SegmentVisit] = {}
        for time_ns in sorted(times_ns) if numbers else ():
            number = nearest(self._segments, numbers, time_ns)
            visits.setdefault(number, SegmentVisit(self._segments[number])).targets[topic].append(time_ns)
        for _, visit in sorted(visits.items()):
            self._read_visit(visit, [topic], {topic: [probe]})
        self._note_damage(topic, [probe])

    def _note_damage(self, topic: str, probes: Sequence[SampleSink]) -> None:
        for probe in probes if topic in self._damaged else ():
            probe.note_damage(self._damaged[topic])

    def _read_visit(self, visit: SegmentVisit, topics: list[str], probes: Mapping[str, Sequence[SampleSink]]) -> None:
        picker = _Picker(visit)
        for block, is_last in self._blocks(visit.segment, topics):
            picks, around = picker.pick(block, is_last=is_last)
            for number, message in enumerate(block):
                self._counts[message.topic] += 1
                if not self._is_whole and number not in around:
                    continue
                sample = SampledMessage(RecordedTopic(self.name, message.topic), message, is_picked=number in picks)
                for probe in probes[message.topic]:
                    probe.add(sample)

    def _blocks(self, segment: Segment, topics: list[str]) -> Iterator[tuple[list[RawMessage], bool]]:
        """Yield the messages of a segment, and whether they are the last ones. Damage is noted for its topics."""
        waiting: list[RawMessage] | None = None
        known = len(self._recording.damage)
        failure = ""
        try:
            for block in self._recording.segment_messages(segment, topics):
                if waiting is not None:
                    yield waiting, False
                waiting = block
        except RecordingError as error:
            failure = str(error)
            self._failure = self._failure or failure
        if not failure and len(damage := self._recording.damage) > known:
            failure = f"{damage[known].where}: {damage[known].message}"
        if failure:
            for topic in topics if segment.topics is None else segment.topics.intersection(topics):
                self._damaged.setdefault(topic, failure)
        if waiting is not None:
            yield waiting, True

    def _search(self, topics: list[str], probes: Mapping[str, Sequence[SampleSink]]) -> None:
        """Look for topics of which no sample has a message, in a format whose index does not say where they are.

        The rows of the other topics are passed over, which reads a page of each.
        """
        start_ns, end_ns, count = self._recording.start_ns, self._recording.end_ns, self._recording.message_count
        if start_ns is None or end_ns is None or (count or 0) * _PAGE_BYTES > _MAX_SEARCH_BYTES:
            return
        slices = max(self._samples[topic] for topic in topics)
        edges = [start_ns + (end_ns + 1 - start_ns) * number // slices for number in range(slices + 1)]
        for topic in topics:
            for number in range(slices):
                message = self._first_in(topic, edges[number], edges[number + 1])
                if message is not None:
                    self._counts[topic] += 1
                    sample = SampledMessage(RecordedTopic(self.name, topic), message, is_picked=True)
                    for probe in probes[topic]:
                        probe.add(sample)

    def _first_in(self, topic: str, start_ns: int, end_ns: int) -> RawMessage | None:
        try:
            return next(self._recording.raw_messages([topic], start=start_ns, end=end_ns), None)
        except RecordingError as error:
            self._failure = self._failure or str(error)
            return None


class _Picker:
    """Picks the messages of a segment that are nearest to the target times of their topics."""

    def __init__(self, visit: SegmentVisit) -> None:
        first_ns, last_ns = visit.segment.first_ns, visit.segment.last_ns
        self._is_unbounded = last_ns >= _UNKNOWN_END_NS
        self._targets = {
            topic: [min(max(time_ns, first_ns), last_ns) for time_ns in times] for topic, times in visit.targets.items()
        }

    def pick(self, block: Sequence[RawMessage], *, is_last: bool) -> tuple[set[int], set[int]]:
        """Return which messages of a block are samples, and these with the messages around them."""
        places: dict[str, list[int]] = defaultdict(list)
        for number, message in enumerate(block):
            places[message.topic].append(number)
        picks: set[int] = set()
        around: set[int] = set()
        for topic, numbers in places.items():
            times = [block[number].log_time_ns for number in numbers]
            picked = [_nearest_time(times, time_ns) for time_ns in self._due(topic, times[-1], is_last=is_last)]
            picks.update(numbers[place] for place in picked)
            reach = _AROUND // max(1, len(picked))
            for place in picked or [len(numbers) // 2]:
                around.update(numbers[max(0, place - reach) : place + reach + 1])
        return picks, around

    def _due(self, topic: str, last_ns: int, *, is_last: bool) -> list[int]:
        """Return the target times that a block of the topic up to a time is the nearest to, and forget them."""
        targets = self._targets.get(topic, [])
        cut = len(targets) if is_last else bisect_left(targets, last_ns)
        if self._is_unbounded:  # the times are unknown: one of each block
            cut = 1
        self._targets[topic] = targets[cut:]
        return targets[:cut]


def _nearest_time(times: Sequence[int], time_ns: int) -> int:
    place = bisect_left(times, time_ns)
    around = range(max(0, place - 1), min(len(times), place + 1))
    return min(around, key=lambda number: abs(times[number] - time_ns))
