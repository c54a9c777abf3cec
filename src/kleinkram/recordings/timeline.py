"""Log times of topics: counts, spans and gaps, exact and in bounded memory, for messages in any order.

Stamps are added in the order of the file, which decides what is out of order; gaps need the order of time. So stamps
wait (8 bytes each) until no earlier one can follow: `finish(before_ns)` states up to where that is certain (the
smallest start of all chunks still to come), and then only a summary of each topic is left. If more than
`MAX_PENDING_STAMPS` wait, the older half is finished early; if an earlier stamp follows after all, the longest gap of
that topic is an upper bound, and the summary reports it.

**Suspect stamps.** Sorted by time, the messages of a recording form clusters with more than a year of silence between
them. The cluster with the most messages is the recording; stamps in all others (1970, or a clock that jumped) are
suspect: counted, reported, and left out of spans, rates and gaps.

**Clock jumps.** A stamp more than `MIN_JUMP_NS` below the previous one of its topic, in the order of the file, is not a
buffer that was written late, but a clock that was set back; the largest jump of a topic is stored.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import accumulate, pairwise
from operator import itemgetter, lt, sub

from kleinkram.recordings.limits import MAX_PENDING_STAMPS
from kleinkram.recordings.message_density import MAX_BINS, add_up, bins_per_topic, count_stamps
from kleinkram.recordings.model import MessageDensity

YEAR_NS = 366 * 24 * 3600 * 1_000_000_000
MIN_JUMP_NS = 10 * 1_000_000_000
FINISH_AT = 65_536
"""Stamps that wait before any are finished, because each call has a cost for each topic."""

_KEY_BITS = 20


@dataclass(frozen=True)
class StampSpan:
    """Messages of one topic without a year of silence between them; both ends inclusive. `density`: None if unknown."""

    first_ns: int
    last_ns: int
    count: int
    longest_gap_ns: int
    density: MessageDensity | None = None


@dataclass(frozen=True)
class Jump:
    """A clock that was set back: the last stamp before, the first after, and the first after it was set forward."""

    before_ns: int
    after_ns: int
    return_ns: int | None = None


@dataclass
class TopicTimes:
    """The stamps of one topic so far."""

    count: int = 0
    out_of_order: int = 0
    stored_bytes: int = 0
    latest_ns: int = -1
    previous_ns: int = -1
    jump: Jump | None = None
    earliest_pending_ns: int = 0
    spans: list[StampSpan] = field(default_factory=list)
    gaps_are_upper_bounds: bool = False
    pending: array[int] = field(default_factory=lambda: array("Q"))

    def add(self, stamps: Sequence[int]) -> None:
        """Add stamps in the order of the file."""
        if not stamps:
            return
        self.count += len(stamps)
        highest = max(stamps)
        is_disordered = stamps[0] < self.latest_ns or any(map(lt, stamps[1:], stamps))
        if is_disordered:
            before = accumulate(stamps, max, initial=self.latest_ns)
            self.out_of_order += sum(map(lt, stamps, before))
        if is_disordered or (self.jump is not None and self.jump.return_ns is None):
            self._watch_clock(stamps)
        self.previous_ns = stamps[-1]
        self.latest_ns = max(self.latest_ns, highest)
        earliest = min(stamps)
        self.earliest_pending_ns = min(self.earliest_pending_ns, earliest) if self.pending else earliest
        self.pending.extend(stamps)

    def _watch_clock(self, stamps: Sequence[int]) -> None:
        """Note the largest jump back, and where the clock was set forward again."""
        before = [self.previous_ns if self.previous_ns >= 0 else stamps[0], *stamps[:-1]]
        steps = list(map(sub, stamps, before))
        back_ns = -min(steps)
        known_ns = self.jump.before_ns - self.jump.after_ns if self.jump is not None else MIN_JUMP_NS
        if known_ns < back_ns < YEAR_NS:
            at = steps.index(-back_ns)
            self.jump, known_ns = Jump(before[at], stamps[at]), back_ns
            steps[: at + 1] = [0] * (at + 1)
        forward_ns = max(steps)
        if self.jump is not None and self.jump.return_ns is None and 2 * forward_ns > known_ns:
            self.jump = replace(self.jump, return_ns=stamps[steps.index(forward_ns)])

    def finish(self, before_ns: int | None, max_bins: int) -> None:
        """Turn pending stamps below `before_ns` (None: all) into spans, whose density has at most `max_bins`."""
        if not self.pending or (before_ns is not None and self.earliest_pending_ns >= before_ns):
            return
        stamps = sorted(self.pending)
        cut = len(stamps) if before_ns is None else bisect_left(stamps, before_ns)
        if cut:
            # Whichever span these join, its bins are at least as wide, and theirs need not be narrower.
            bin_ns = min((span.density.bin_ns for span in self.spans if span.density), default=1)
            for span in _split(stamps[:cut], bin_ns, max_bins):
                self._absorb(span, max_bins)
            self.pending = array("Q", stamps[cut:])
            self.earliest_pending_ns = self.pending[0] if self.pending else 0

    def append(self, later: TopicTimes) -> None:
        """Add the stamps of a later part of the file."""
        out_of_order, jump = self.out_of_order + later.out_of_order, self.jump or later.jump
        self.add(later.pending)
        self.out_of_order, self.jump = out_of_order, jump
        self.count += later.count - len(later.pending)
        self.stored_bytes += later.stored_bytes
        self.latest_ns = max(self.latest_ns, later.latest_ns)
        self.gaps_are_upper_bounds = self.gaps_are_upper_bounds or later.gaps_are_upper_bounds
        for span in later.spans:
            self._absorb(span, MAX_BINS)

    def _absorb(self, span: StampSpan, max_bins: int) -> None:
        if self.spans and span.first_ns < self.spans[-1].last_ns:
            late = any(span.first_ns < known.last_ns and known.first_ns < span.last_ns for known in self.spans)
            self.gaps_are_upper_bounds = self.gaps_are_upper_bounds or late
        self.spans = join_spans([*self.spans, span], max_bins)


def _split(stamps: Sequence[int], bin_ns: int, max_bins: int) -> list[StampSpan]:
    """Split sorted stamps at gaps of more than a year."""
    gaps = list(map(sub, stamps[1:], stamps))
    longest = max(gaps, default=0)
    if longest <= YEAR_NS:
        density = count_stamps(stamps, min_bin_ns=bin_ns, max_bins=max_bins)
        return [StampSpan(stamps[0], stamps[-1], len(stamps), longest, density)]
    cuts = [0, *(i + 1 for i, gap in enumerate(gaps) if gap > YEAR_NS), len(stamps)]
    return [
        StampSpan(
            stamps[a],
            stamps[b - 1],
            b - a,
            max(gaps[a : b - 1], default=0),
            count_stamps(stamps[a:b], max_bins=max_bins),
        )
        for a, b in pairwise(cuts)
    ]


def join_spans(spans: Iterable[StampSpan], max_bins: int = MAX_BINS) -> list[StampSpan]:
    """Join spans that overlap or are within a year of each other; sorted by time, each density with at most `max_bins`.

    The gap between two spans that do not overlap counts as a gap of the joined one.
    """
    joined: list[StampSpan] = []
    for span in sorted(spans, key=lambda span: span.first_ns):
        previous = joined[-1] if joined else None
        if previous is None or span.first_ns - previous.last_ns > YEAR_NS:
            joined.append(span)
            continue
        between = max(0, span.first_ns - previous.last_ns)
        joined[-1] = StampSpan(
            previous.first_ns,
            max(previous.last_ns, span.last_ns),
            previous.count + span.count,
            max(previous.longest_gap_ns, span.longest_gap_ns, between),
            _both(previous.density, span.density, max_bins),
        )
    return joined


def _both(one: MessageDensity | None, other: MessageDensity | None, max_bins: int = MAX_BINS) -> MessageDensity | None:
    return add_up((one, other), max_bins=max_bins) if one is not None and other is not None else None


def main_cluster(spans: Iterable[StampSpan]) -> StampSpan | None:
    """Return the cluster with the most messages over all topics, the latest of equals; None without messages."""
    bare = [StampSpan(span.first_ns, span.last_ns, span.count, span.longest_gap_ns) for span in spans]
    return max(join_spans(bare), key=lambda span: (span.count, span.first_ns), default=None)


def span_in_cluster(spans: Iterable[StampSpan], cluster: StampSpan | None) -> StampSpan | None:
    """Return the spans of a topic inside the cluster as one; None if there are none."""
    if cluster is None:
        return None
    inside = [span for span in spans if cluster.first_ns <= span.first_ns <= cluster.last_ns]
    if not inside:
        return None
    gaps = [span.longest_gap_ns for span in inside]
    gaps += [after.first_ns - before.last_ns for before, after in pairwise(inside)]
    density = reduce(_both, [span.density for span in inside])
    return StampSpan(inside[0].first_ns, inside[-1].last_ns, sum(span.count for span in inside), max(gaps), density)


@dataclass(frozen=True)
class ChunkEntries:
    """The index of one topic in one chunk: log times, and offsets in the uncompressed chunk."""

    topic: str
    stamps: Sequence[int]
    offsets: Sequence[int]


class Timeline:
    """The stamps of all topics of one file."""

    def __init__(self) -> None:
        self.topics: dict[str, TopicTimes] = {}
        self._pending = 0
        self._finish_at = FINISH_AT

    def topic(self, name: str) -> TopicTimes:
        """Return the times of a topic, empty ones if it is new."""
        times = self.topics.get(name)
        if times is None:
            times = self.topics[name] = TopicTimes()
        return times

    def rename(self, old: str, new: str) -> None:
        """Move the messages of a topic to another one, after those that it has."""
        times = self.topics.pop(old, None)
        if times is not None:
            self.topic(new).append(times)

    def add(self, name: str, stamps: Sequence[int], stored_bytes: int) -> None:
        """Add messages of one topic, in the order of the file."""
        times = self.topic(name)
        times.add(stamps)
        times.stored_bytes += stored_bytes
        self._pending += len(stamps)

    def add_chunk(self, entries: Sequence[ChunkEntries], *, uncompressed_bytes: int, stored_bytes: int) -> None:
        """Add the indexes of one chunk, at most one of each topic, in any order of messages.

        A topic's share of the stored bytes is its share of the uncompressed ones: a message reaches to the next or to
        the end.
        """
        shares = _message_bytes(entries, uncompressed_bytes)
        for entry, share in zip(entries, shares, strict=True):
            stored = share * stored_bytes // uncompressed_bytes if uncompressed_bytes else 0
            stamps = entry.stamps
            if any(map(lt, entry.offsets[1:], entry.offsets)):  # not in file order
                stamps = [stamp for _, stamp in sorted(zip(entry.offsets, stamps, strict=True), key=itemgetter(0))]
            self.add(entry.topic, stamps, stored)

    def finish(self, before_ns: int | None) -> None:
        """State that no stamp below `before_ns` will follow; None: none at all."""
        if before_ns is not None and self._pending < self._finish_at:
            self.bound()
            return
        max_bins = bins_per_topic(len(self.topics))
        for times in self.topics.values():
            if times.pending:
                times.finish(before_ns, max_bins)
        self._pending = sum(len(times.pending) for times in self.topics.values())
        # Where many stamps wait for long, the next call waits for as many more.
        self._finish_at = max(FINISH_AT, 2 * self._pending)
        self.bound()

    def bound(self) -> None:
        """Keep at most `MAX_PENDING_STAMPS` stamps pending: finish the older half of more."""
        if self._pending <= MAX_PENDING_STAMPS:
            return
        max_bins = bins_per_topic(len(self.topics))
        for times in self.topics.values():
            if times.pending:
                stamps = sorted(times.pending)
                # Including the one in the middle: all of them may be equal.
                times.finish(stamps[len(stamps) // 2] + 1, max_bins)
        self._pending = sum(len(times.pending) for times in self.topics.values())


def _message_bytes(entries: Sequence[ChunkEntries], uncompressed_bytes: int) -> list[int]:
    """Return the uncompressed bytes of each entry's messages."""
    keys: list[int] = []
    for number, entry in enumerate(entries):
        keys += [offset << _KEY_BITS | number for offset in entry.offsets]
    keys.sort()
    mask = (1 << _KEY_BITS) - 1
    shares = [0] * len(entries)
    starts = [key >> _KEY_BITS for key in keys]
    ends = [*starts[1:], max(uncompressed_bytes, starts[-1] if starts else 0)]
    for key, size in zip(keys, map(sub, ends, starts), strict=True):
        shares[key & mask] += size
    return shares
