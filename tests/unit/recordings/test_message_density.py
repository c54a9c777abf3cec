"""Message counts per bin agree with counting each message."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings import timeline as timeline_module
from kleinkram.recordings.combine_summaries import combine
from kleinkram.recordings.file_summary import TopicType, build_summary
from kleinkram.recordings.isolation import from_dict, to_dict
from kleinkram.recordings.message_density import (
    BINS_OF_MANY_TOPICS,
    MANY_TOPICS,
    MAX_BINS,
    add_up,
    count_stamps,
    on_axis,
    pack,
    unpack,
)
from kleinkram.recordings.model import Content, MessageDensity, RecordingFormat, RecordingSummary
from kleinkram.recordings.timeline import YEAR_NS, Timeline

NO_TYPE = [TopicType("", "", "")]
T0 = 1_700_000_000_000_000_000
STAMPS = st.lists(
    st.integers(0, 2_000) | st.integers(T0, T0 + 10**4) | st.integers(T0, T0 + 10**12) | st.integers(0, 2**64 - 1),
    min_size=1,
    max_size=400,
)
NEAR = st.lists(st.integers(T0, T0 + 10**5) | st.integers(T0, T0 + 10**13), min_size=1, max_size=60)


def plainly(stamps: list[int], most: int = MAX_BINS) -> MessageDensity:
    """Count every stamp by itself, in the narrowest bins that are few enough."""
    bits = next(item for item in range(65) if (max(stamps) >> item) - (min(stamps) >> item) < most)
    counted = Counter(stamp >> bits for stamp in stamps)
    numbers = range(min(counted), max(counted) + 1)
    return MessageDensity(min(counted) << bits, 1 << bits, tuple(counted[number] for number in numbers))


def topic_density(chunks: list[list[int]]) -> MessageDensity | None:
    timeline = Timeline()
    for chunk in chunks:
        timeline.add("/t", chunk, 0)
        timeline.finish(0)
    timeline.finish(None)
    return build_summary(RecordingFormat.mcap, timeline, {"/t": NO_TYPE}).topics[0].density


@given(STAMPS, st.sampled_from([1, 2, 64, MAX_BINS]))
@settings(deadline=None)
def test_bins_are_as_narrow_as_they_may_be_and_count_right(stamps: list[int], most: int) -> None:
    assert count_stamps(sorted(stamps), max_bins=most) == plainly(stamps, most)


@given(st.lists(STAMPS, min_size=1, max_size=5), st.randoms(use_true_random=False))
@settings(deadline=None)
def test_parts_add_up_to_the_total_in_any_order(parts: list[list[int]], order: object) -> None:
    order.shuffle(parts)  # type: ignore[attr-defined]  # what st.randoms gives
    whole = plainly([stamp for part in parts for stamp in part])
    assert add_up(count_stamps(sorted(part)) for part in parts) == whole
    one_by_one = None
    for part in parts:
        density = count_stamps(sorted(part))
        one_by_one = density if one_by_one is None else add_up([one_by_one, density])
    assert one_by_one == whole


@given(st.lists(NEAR, min_size=1, max_size=6), st.sampled_from([3, 10**6]))
@settings(deadline=None)
def test_a_timeline_counts_whatever_the_order_and_the_memory(chunks: list[list[int]], pending: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timeline_module, "MAX_PENDING_STAMPS", pending)
        patch.setattr(timeline_module, "FINISH_AT", 3)
        assert topic_density(chunks) == plainly([stamp for chunk in chunks for stamp in chunk])


def test_suspect_stamps_are_in_no_bin_and_do_not_widen_them() -> None:
    real = [T0 + number * 10**6 for number in range(1000)]
    for unusual in ([5, 6], [T0 + 20 * YEAR_NS]):
        assert topic_density([unusual, real]) == topic_density([real[:400], unusual, real[400:]]) == plainly(real)


@given(st.lists(NEAR, min_size=1, max_size=5))
@settings(deadline=None)
def test_files_add_up_to_their_recording(files: list[list[int]]) -> None:
    summaries = []
    for stamps in files:
        timeline = Timeline()
        timeline.add("/t", stamps, 0)
        timeline.finish(None)
        actual = build_summary(RecordingFormat.mcap, timeline, {"/t": NO_TYPE})
        summaries.append(
            RecordingSummary(
                RecordingFormat.mcap,
                Content.indexed,
                message_count=actual.message_count,
                start_ns=actual.start_ns,
                end_ns=actual.end_ns,
                topics=actual.topics,
            )
        )
    whole = combine(summaries)
    assert whole.topics[0].density == plainly([stamp for stamps in files for stamp in stamps])
    assert from_dict(to_dict(whole)) == whole


@given(STAMPS, st.integers(0, 5), st.integers(-300, 300), st.integers(1, 512))
@settings(deadline=None)
def test_counts_on_an_axis_are_those_of_its_range(stamps: list[int], wider: int, shift: int, bins: int) -> None:
    density = plainly(stamps)
    bin_ns = density.bin_ns << wider
    first = max(0, density.start_ns // bin_ns + shift)
    shown = on_axis(density, start_ns=first * bin_ns, bin_ns=bin_ns, bins=bins)
    counted = Counter(stamp // bin_ns for stamp in stamps)
    assert shown == [counted[first + number] for number in range(bins)]


@given(STAMPS, st.integers(1, 2**40))
@settings(deadline=None)
def test_packed_and_unpacked_is_the_same(stamps: list[int], times: int) -> None:
    density = plainly(stamps)
    large = MessageDensity(density.start_ns, density.bin_ns, tuple(count * times for count in density.counts))
    assert unpack(pack(large)) == large
    assert len(pack(density)) <= 10 + 2 * MAX_BINS


def test_a_file_with_very_many_topics_has_fewer_bins_of_each() -> None:
    timeline = Timeline()
    stamps = [T0 + number * 1000 for number in range(300)]
    timeline.add("/t", stamps, 0)
    timeline.finish(None)
    for number in range(MANY_TOPICS):
        timeline.topic(f"/{number}")
    types = dict.fromkeys(timeline.topics, NO_TYPE)
    density = next(
        topic.density for topic in build_summary(RecordingFormat.mcap, timeline, types).topics if topic.name == "/t"
    )
    assert density == plainly(stamps, BINS_OF_MANY_TOPICS)
