"""The messages that a scan finds: batches, their locations in the file, and counts and times by topic.

A message refers to its channel by a number, which the file may define only later, even at its end. Until then, its
messages are counted under the number.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import islice
from operator import sub
from typing import NamedTuple, Protocol

from kleinkram.recordings.limits import MAX_TOPICS
from kleinkram.recordings.timeline import Timeline

BATCH_STRIDE = 3  # numbers that a `Batch` keeps of a message: log time, publish time (0: none), bytes of its record

_SAMPLE = 4096
_NOTABLE_NS = 1_000_000_000
_MAX_INT64 = 2**63 - 1
_PLACEHOLDER = "\udcff channel "  # no topic of a file begins so: what is not UTF-8 in one was replaced


class HasTopic(Protocol):
    """A channel or connection."""

    @property
    def topic(self) -> str:
        """Its topic."""


class Batch(dict[int, "array[int]"]):
    """Messages by channel number, `BATCH_STRIDE` numbers each. Channels of one topic share one array, in file order."""

    def __init__(self, channels: Mapping[int, HasTopic]) -> None:
        super().__init__()
        self._channels = channels
        self.arrays: dict[str | int, array[int]] = {}
        """By topic, or by number where the topic is not known (yet)."""

    def __missing__(self, number: int) -> array[int]:
        channel = self._channels.get(number)
        key = number if channel is None else channel.topic
        rows = self[number] = self.arrays.setdefault(key, array("Q"))
        return rows


@dataclass
class Lateness:
    """Messages of one topic whose log and publish times are over a second apart (log minus publish time)."""

    count: int = 0
    largest_ns: int = 0
    sample: array[int] = field(default_factory=lambda: array("q"))

    def add(self, late: Sequence[int]) -> None:
        """Add differences."""
        self.count += len(late)
        self.largest_ns = max(self.largest_ns, *late, key=abs)
        self.sample.extend(late[: _SAMPLE - len(self.sample)])


class MessageCounter:
    """All messages that a scan found; `lateness`: of topics whose log and publish times are far apart."""

    def __init__(self, *, with_publish_times: bool = True) -> None:
        self._with_publish_times = with_publish_times
        self.timeline = Timeline()
        self.messages = 0
        self._topics: dict[int, str] = {}
        self.lateness: dict[str, Lateness] = {}

    def learn(self, channels: Mapping[int, HasTopic]) -> None:
        """Note the topics of all known channels. `channels` may only grow: known ones are not visited again."""
        for number, channel in islice(channels.items(), len(self._topics), None):
            self.define(number, channel.topic)

    def define(self, number: int, topic: str) -> None:
        """Note the topic of a channel; the first one counts."""
        if number not in self._topics:
            self._topics[number] = topic
            self.timeline.rename(_placeholder_topic(number), topic)
            self.timeline.topic(topic)

    def add(self, batch: Batch, *, stored: int = 1, uncompressed: int = 1) -> int:
        """Add messages, with `stored` / `uncompressed` of their bytes in the file; return how many."""
        count = 0
        for key, rows in batch.arrays.items():
            topic = key if isinstance(key, str) else self._topics.get(key)
            if topic is None:
                topic = _placeholder_topic(int(key) if len(self.timeline.topics) <= MAX_TOPICS else 0)
            stamps = rows[0::BATCH_STRIDE]
            share = sum(rows[2::BATCH_STRIDE]) * stored // uncompressed if uncompressed else 0
            self.timeline.add(topic, stamps, share)
            if self._with_publish_times and (published := rows[1::BATCH_STRIDE]) != stamps:
                self._note_lateness(topic, stamps, published)
            count += len(stamps)
        self.timeline.bound()
        self.messages += count
        return count

    def finish(self) -> int:
        """End the timeline; drop the messages that belong to no topic, and return how many."""
        self.timeline.finish(None)
        nameless = [name for name in self.timeline.topics if name.startswith(_PLACEHOLDER)]
        lost = sum(self.timeline.topics.pop(name).count for name in nameless)
        self.messages -= lost
        return lost

    def _note_lateness(self, topic: str, stamps: array[int], published: array[int]) -> None:
        if 0 in published:
            known = [(log, publish) for log, publish in zip(stamps, published, strict=True) if publish]
            stamps, published = array("Q", [log for log, _ in known]), array("Q", [publish for _, publish in known])
        late = list(map(sub, stamps, published))
        if late and (max(late) > _NOTABLE_NS or min(late) < -_NOTABLE_NS):
            notable = [max(-_MAX_INT64, min(_MAX_INT64, ns)) for ns in late if abs(ns) > _NOTABLE_NS]
            self.lateness.setdefault(topic, Lateness()).add(notable)


def _placeholder_topic(number: int) -> str:
    return f"{_PLACEHOLDER}{number}"


class LocationKind(IntEnum):
    """Kind of a position: a chunk, records outside of chunks, or a truncated chunk, read as far as possible."""

    chunk = 0
    records = 1
    cut = 2


ReadableRanges = tuple[tuple[int, int], ...]


class MessageLocation(NamedTuple):
    """Bytes of a file that hold messages: [start, start + length).

    `uncompressed`: bytes of the content. `readable_ranges`: parts [start, end) of it that can be read; None: all of it.
    """

    kind: LocationKind
    start: int
    length: int
    uncompressed: int
    readable_ranges: ReadableRanges | None = None
