"""Counts, gaps, disorder and suspect stamps agree with a naive implementation."""

from __future__ import annotations

from array import array
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings import timeline as timeline_module
from kleinkram.recordings.chunk_table import smallest_to_come
from kleinkram.recordings.file_summary import TopicType, build_summary
from kleinkram.recordings.model import RecordingFormat, RecordingSummary
from kleinkram.recordings.timeline import YEAR_NS, ChunkEntries, Timeline

NO_TYPE = [TopicType("", "", "")]
T0 = 1_700_000_000_000_000_000


def measured(chunks: list[list[int]], *, watermarks: bool = True) -> RecordingSummary:
    """Feed chunks of one topic as a reader of an index does, and finish as early as possible."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timeline_module, "FINISH_AT", 1)
        timeline = Timeline()
    starts = array("Q", [min(chunk) for chunk in chunks])
    for chunk, before_ns in zip(chunks, smallest_to_come(starts), strict=True):
        offsets = [number * 100 for number in range(len(chunk))]
        timeline.add_chunk([ChunkEntries("/t", chunk, offsets)], uncompressed_bytes=len(chunk) * 100, stored_bytes=10)
        timeline.finish(before_ns if watermarks else 0)
    timeline.finish(None)
    return build_summary(RecordingFormat.mcap, timeline, {"/t": NO_TYPE})


def plain_gap(stamps: list[int]) -> int:
    ordered = sorted(stamps)
    return max((b - a for a, b in pairwise(ordered)), default=0)


def plain_disorder(stamps: list[int]) -> int:
    return sum(1 for i, stamp in enumerate(stamps) if stamp < max(stamps[:i], default=0))


CHUNKS = st.lists(st.lists(st.integers(T0, T0 + 10_000), min_size=1, max_size=8), min_size=1, max_size=8)


@given(CHUNKS, st.booleans())
@settings(max_examples=200, deadline=None)
def test_any_order_of_messages_is_exact(chunks: list[list[int]], watermarks: bool) -> None:
    stamps = [stamp for chunk in chunks for stamp in chunk]
    actual = measured(chunks, watermarks=watermarks)
    (topic,) = actual.topics
    assert topic.count == actual.message_count == len(stamps)
    assert (topic.first_ns, topic.last_ns) == (actual.start_ns, actual.end_ns) == (min(stamps), max(stamps))
    assert topic.longest_gap_ns == (plain_gap(stamps) if len(stamps) > 1 else None)
    assert topic.out_of_order_count == plain_disorder(stamps)
    assert actual.problems == ()


@given(CHUNKS)
@settings(max_examples=100, deadline=None)
def test_with_little_memory_a_gap_is_never_too_small(chunks: list[list[int]]) -> None:
    stamps = [stamp for chunk in chunks for stamp in chunk]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timeline_module, "MAX_PENDING_STAMPS", 3)
        actual = measured(chunks, watermarks=False)
    (topic,) = actual.topics
    truth = plain_gap(stamps) if len(stamps) > 1 else None
    assert (topic.count, topic.first_ns, topic.last_ns) == (len(stamps), min(stamps), max(stamps))
    assert topic.out_of_order_count == plain_disorder(stamps)
    if topic.longest_gap_ns != truth:
        assert truth is not None
        assert topic.longest_gap_ns is not None
        assert topic.longest_gap_ns > truth
        assert [problem.code for problem in actual.problems] == ["gaps-upper-bound"]


def test_memory_stays_small_for_a_long_recording() -> None:
    timeline = Timeline()
    for chunk in range(2_000):
        start = T0 + chunk * 1_000
        timeline.add("/t", range(start, start + 1_000), 0)
        timeline.finish(start + 1_000)
    times = timeline.topics["/t"]
    assert times.count == 2_000_000
    assert len(times.pending) <= timeline_module.FINISH_AT
    assert len(times.spans) == 1


def test_memory_stays_small_where_a_clock_stood_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timeline_module, "MAX_PENDING_STAMPS", 1_000)
    timeline = Timeline()
    for _ in range(50):
        timeline.add("/t", [T0] * 100, 0)
        timeline.bound()
        assert len(timeline.topics["/t"].pending) <= 1_000
    timeline.finish(None)
    (topic,) = build_summary(RecordingFormat.mcap, timeline, {"/t": NO_TYPE}).topics
    assert (topic.count, topic.longest_gap_ns, topic.out_of_order_count) == (5_000, 0, 0)


def test_stamps_of_1970_are_suspect() -> None:
    actual = measured([[5, 6], [T0, T0 + 10, T0 + 30]])
    (topic,) = actual.topics
    assert (actual.start_ns, actual.end_ns) == (T0, T0 + 30)
    assert (topic.count, topic.suspect_count, topic.longest_gap_ns) == (5, 2, 20)
    assert topic.rate_hz == pytest.approx(2 / 30e-9)
    assert [(problem.code, problem.where) for problem in actual.problems] == [("suspect-stamps", "/t")]


def test_a_jump_into_the_future_does_not_stretch_the_span() -> None:
    future = T0 + 20 * YEAR_NS
    actual = measured([[T0, T0 + 10, future, T0 + 20]])
    assert (actual.start_ns, actual.end_ns) == (T0, T0 + 20)
    assert actual.topics[0].longest_gap_ns == 10
    assert actual.topics[0].out_of_order_count == 1


def test_small_stamps_alone_are_not_suspect() -> None:
    actual = measured([[2, 3]])
    assert (actual.start_ns, actual.end_ns, actual.problems) == (2, 3, ())


def test_two_topics_share_a_recordings_span() -> None:
    timeline = Timeline()
    timeline.add("/a", [T0, T0 + 100], 0)
    timeline.add("/b", [T0 + 30, T0 + 60], 0)
    timeline.finish(None)
    actual = build_summary(RecordingFormat.mcap, timeline, {"/a": NO_TYPE, "/b": NO_TYPE})
    b = actual.topics[1]
    assert (b.head_gap_ns, b.tail_gap_ns, b.longest_gap_ns) == (30, 40, 30)


def test_offsets_give_the_order_of_the_file() -> None:
    timeline = Timeline()
    timeline.add_chunk([ChunkEntries("/t", [1, 2, 3], [200, 100, 0])], uncompressed_bytes=300, stored_bytes=300)
    timeline.finish(None)
    assert timeline.topics["/t"].out_of_order == 2


def test_stored_bytes_are_shared_by_uncompressed_size() -> None:
    timeline = Timeline()
    entries = [ChunkEntries("/small", [1, 2], [0, 400]), ChunkEntries("/large", [1], [100])]
    timeline.add_chunk(entries, uncompressed_bytes=500, stored_bytes=50)
    assert timeline.topics["/small"].stored_bytes == 20
    assert timeline.topics["/large"].stored_bytes == 30
