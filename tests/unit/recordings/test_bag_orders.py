"""Bags with chunks out of time order and several connections per topic."""

from __future__ import annotations

from io import BytesIO

import pytest

from kleinkram.recordings import Content, RecordingSummary, summarise
from kleinkram.recordings.sources import SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import BagCompression, BagWriter

T0 = 1_700_000_000_000_000_000
STEP = 100_000_000
MESSAGES = 60
PER_CHUNK = 10
COMPRESSIONS = [*BagCompression]


def bag(numbers: list[int], compression: BagCompression, *, connections: int = 1) -> bytes:
    """A bag of one topic, whose messages stand in this order, about `PER_CHUNK` in a chunk."""
    out = BytesIO()
    writer = BagWriter(out, compression=compression, chunk_bytes=PER_CHUNK * 100)
    known = [writer.add_connection("/imu", "a/B", md5sum="*", definition="int8 x") for _ in range(connections)]
    for place, number in enumerate(numbers):
        writer.add_message(known[place % connections], T0 + number * STEP, bytes(50))
    writer.finish()
    return out.getvalue()


def both(data: bytes) -> list[RecordingSummary]:
    """What the summary says, and what the scan says."""
    return [summarise(MemorySource(data, "a.bag")), scan(SourceReader(MemorySource(data, "a.bag")))]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_unsorted_chunks_make_no_gap(compression: BagCompression) -> None:
    halves = [*range(MESSAGES // 2, MESSAGES), *range(MESSAGES // 2)]
    for summary in both(bag(halves, compression)):
        (topic,) = summary.topics
        assert summary.content is Content.indexed
        assert (topic.count, topic.first_ns, topic.last_ns) == (MESSAGES, T0, T0 + (MESSAGES - 1) * STEP)
        assert topic.longest_gap_ns == STEP
        assert topic.out_of_order_count == MESSAGES // 2


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_connections_of_one_topic_are_one_topic(compression: BagCompression) -> None:
    for summary in both(bag([*range(MESSAGES)], compression, connections=3)):
        (topic,) = summary.topics
        assert (summary.content, summary.reason) == (Content.indexed, None)
        assert (topic.name, topic.count, topic.out_of_order_count) == ("/imu", MESSAGES, 0)
        assert topic.longest_gap_ns == STEP
