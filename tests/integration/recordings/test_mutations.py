"""Any change of a file's bytes yields a summary: no exception, no hang, no invented count."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings import Content, summarise
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.writers import Compression
from tests.unit.recordings.test_hostile import small_bag, small_mcap

MCAPS = [small_mcap(compression) for compression in Compression]
BAG = small_bag()
EDITS = st.lists(st.tuples(st.floats(0, 1), st.binary(min_size=1, max_size=9)), max_size=4)
SOUND = (Content.indexed, Content.recovered, Content.broken, Content.opaque)


def mutated(data: bytes, edits: list[tuple[float, bytes]], keep: float) -> bytes:
    changed = bytearray(data)
    for place, patch in edits:
        at = int(place * (len(data) - 1))
        changed[at : at + len(patch)] = patch
    return bytes(changed[: int(len(data) * keep)])


@given(st.sampled_from(MCAPS), EDITS, st.one_of(st.just(1.0), st.floats(0, 1)))
@settings(max_examples=400, deadline=10_000)
def test_mutated_mcap(data: bytes, edits: list[tuple[float, bytes]], keep: float) -> None:
    summary = summarise(MemorySource(mutated(data, edits, keep)))
    assert summary.content in SOUND
    assert (summary.message_count or 0) <= len(data) // 16
    assert (summary.content is Content.indexed) == (summary.reason is None)


@given(EDITS, st.one_of(st.just(1.0), st.floats(0, 1)))
@settings(max_examples=400, deadline=10_000)
def test_mutated_bag(edits: list[tuple[float, bytes]], keep: float) -> None:
    summary = summarise(MemorySource(mutated(BAG, edits, keep), "test.bag"))
    assert summary.content in SOUND
    assert (summary.message_count or 0) <= len(BAG) // 12
    assert (summary.content is Content.indexed) == (summary.reason is None)


def test_every_second_cut_of_an_mcap_is_reported() -> None:
    data = MCAPS[0]
    actual = [summarise(MemorySource(data[:length])) for length in range(8, len(data), 2)]
    assert {summary.content for summary in actual} == {Content.broken, Content.recovered}
    counts = [summary.message_count or 0 for summary in actual]
    assert counts == sorted(counts)
    assert counts[-1] == 40
    assert summarise(MemorySource(data)).content is Content.indexed


def test_every_second_cut_of_a_bag_is_reported() -> None:
    actual = [summarise(MemorySource(BAG[:length], "test.bag")) for length in range(13, len(BAG), 2)]
    assert {summary.content for summary in actual} == {Content.broken, Content.recovered}
    counts = [summary.message_count or 0 for summary in actual]
    assert counts == sorted(counts)
    assert counts[-1] == 40
    assert summarise(MemorySource(BAG, "test.bag")).content is Content.indexed
