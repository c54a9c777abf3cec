"""Chooses which segments of a recording are read, so that every topic is seen at times spread over the recording.

The times are the same for all topics, so that topics share segments. Where they are far apart, they come in pairs:
a second one follows a short time after each, by which a standstill shows.
"""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from kleinkram.recordings.formats.base import Segment

READ_WHOLE_BYTES = 64 * 2**20
"""Bytes of recordings up to which all messages of the topics are read."""

READ_WHOLE_MESSAGES = 150_000
"""And messages up to which they are: to decode and measure one takes about 20 µs."""

_MIN_BUDGET_BYTES, _BUDGET_SHARE = 32 * 2**20, 0.04
_FEWEST, _FEWEST_PAIRS, _REDUCTION = 2, 4, 0.85


def default_budget(total_bytes: int) -> int:
    """Return the bytes that are read of recordings: all of small ones, 4 % of large ones."""
    if total_bytes <= READ_WHOLE_BYTES:
        return READ_WHOLE_BYTES
    return max(_MIN_BUDGET_BYTES, int(total_bytes * _BUDGET_SHARE))


@dataclass
class SegmentVisit:
    """A segment to be read. `targets`: of each topic, the times of its samples, in order; others are read along."""

    segment: Segment
    targets: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))


def plan_whole(segments: Sequence[Segment], samples: Mapping[str, int]) -> list[SegmentVisit]:
    """Return visits of all segments, with the times of the samples of each topic."""
    visits = [SegmentVisit(segment) for segment in segments]
    for topic, count in samples.items():
        if numbers := _holding(segments, topic):
            for time_ns in sample_times(*_span(segments, numbers), count, 0):
                visits[nearest(segments, numbers, time_ns)].targets[topic].append(time_ns)
    return visits


def plan_visits(
    segments: Sequence[Segment], samples: Mapping[str, int], pair_gap_ns: int, budget_bytes: int
) -> list[SegmentVisit]:
    """Return the segments that are read for samples, in the order of time.

    Args:
        segments: those with the topics, by first time.
        samples: how many messages are needed of each topic.
        pair_gap_ns: time between the two of a pair.
        budget_bytes: of the segments together. Where that is too little, there are fewer segments, from which several
            samples are taken; at least two for each topic while the budget lasts.
    """
    candidates = {topic: _holding(segments, topic) for topic in samples}
    share = 1.0
    while True:
        reduced = {topic: max(_FEWEST, int(count * share)) for topic, count in samples.items()}
        visits = _chosen_visits(segments, candidates, reduced, pair_gap_ns)
        is_least = all(count == _FEWEST for count in reduced.values())
        if is_least or sum(visit.segment.size_bytes for visit in visits) <= budget_bytes:
            for visit in visits:
                _add_targets(visit, {topic: -(-samples[topic] // reduced[topic]) for topic in visit.targets})
            return _within(visits, budget_bytes) if is_least else visits
        share *= _REDUCTION


def _add_targets(visit: SegmentVisit, factors: Mapping[str, int]) -> None:
    """Take several samples of each topic from a segment, where there are fewer segments than samples."""
    first_ns, last_ns = visit.segment.first_ns, visit.segment.last_ns
    for topic, times in visit.targets.items():
        count = factors[topic] * len(times)
        if factors[topic] > 1:
            visit.targets[topic] = [first_ns + (last_ns - first_ns) * step // (count - 1) for step in range(count)]


def sample_times(first_ns: int, last_ns: int, count: int, pair_gap_ns: int) -> list[int]:
    """Return times spread evenly over a span, its ends among them; in pairs if they are far apart."""
    if count < _FEWEST or last_ns <= first_ns:
        return [first_ns] * min(count, 1)
    spacing_ns = (last_ns - first_ns) // (count - 1)
    if count < 2 * _FEWEST_PAIRS or not 0 < 2 * pair_gap_ns < spacing_ns:
        return [first_ns + (last_ns - first_ns) * step // (count - 1) for step in range(count)]
    pairs = count // 2
    starts = [first_ns + (last_ns - pair_gap_ns - first_ns) * step // (pairs - 1) for step in range(pairs)]
    return [time_ns for start_ns in starts for time_ns in (start_ns, start_ns + pair_gap_ns)]


def nearest(segments: Sequence[Segment], numbers: Sequence[int], time_ns: int) -> int:
    """Return which of the numbered segments, in the order of first times, is nearest to a time."""
    place = bisect_left(numbers, time_ns, key=lambda number: segments[number].first_ns)
    around = numbers[max(0, place - 2) : place + 1]
    return min(around, key=lambda number: _distance(segments[number], time_ns))


def _holding(segments: Sequence[Segment], topic: str) -> list[int]:
    return [n for n, segment in enumerate(segments) if segment.topics is None or topic in segment.topics]


def _span(segments: Sequence[Segment], numbers: Sequence[int]) -> tuple[int, int]:
    return segments[numbers[0]].first_ns, max(segments[number].last_ns for number in numbers)


def _chosen_visits(
    segments: Sequence[Segment],
    candidates: Mapping[str, list[int]],
    samples: Mapping[str, int],
    pair_gap_ns: int,
) -> list[SegmentVisit]:
    """Choose segments for the rarest topics first; others join them where that is near enough."""
    visits: dict[int, SegmentVisit] = {}
    chosen_by_topic: dict[str, list[int]] = defaultdict(list)
    for topic in sorted(candidates, key=lambda name: (len(candidates[name]), name)):
        numbers = candidates[topic]
        if not numbers:
            continue
        times = sample_times(*_span(segments, numbers), samples[topic], pair_gap_ns)
        reach_ns = min((later - earlier for earlier, later in pairwise(times)), default=0) // 3
        for time_ns in times:
            number = nearest(segments, numbers, time_ns)
            joined = [
                other
                for other in chosen_by_topic[topic]
                if abs(_distance(segments[other], time_ns)) <= reach_ns + _distance(segments[number], time_ns)
            ]
            if joined:
                number = min(joined, key=lambda other: _distance(segments[other], time_ns))
            elif number not in visits:
                visits[number] = SegmentVisit(segments[number])
                for name in candidates if segments[number].topics is None else segments[number].topics or ():
                    chosen_by_topic[name].append(number)
            visits[number].targets[topic].append(time_ns)
    return [visits[number] for number in sorted(visits)]


def _within(visits: Sequence[SegmentVisit], budget_bytes: int) -> list[SegmentVisit]:
    """Return as many visits as the budget allows, at least one, spread over the recording."""
    size_bytes = 0
    numbers: list[int] = []
    for number in _spread_order(len(visits)):
        size_bytes += visits[number].segment.size_bytes
        if numbers and size_bytes > budget_bytes:
            break
        numbers.append(number)
    return [visits[number] for number in sorted(numbers)]


def _spread_order(count: int) -> list[int]:
    """Return the numbers below `count` so that the first ones are spread evenly: by their reversed bits."""
    bits = max(1, (count - 1).bit_length())
    return sorted(range(count), key=lambda number: int(format(number, f"0{bits}b")[::-1], 2))


def _distance(segment: Segment, time_ns: int) -> int:
    if segment.first_ns <= time_ns <= segment.last_ns:
        return 0
    return min(abs(segment.first_ns - time_ns), abs(segment.last_ns - time_ns))
