"""Whatever happens to the bytes of a file, there is a summary: no exception, no hang, no count out of thin air."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from kleinkram.recordings import Content, summarise
from kleinkram.recordings.mcap.writer import Compression

from .memory_source import MemorySource
from .test_hostile import small_bag, small_mcap

MCAPS = [small_mcap(compression) for compression in Compression]
BAG = small_bag()
EDITS = st.lists(st.tuples(st.floats(0, 1), st.binary(min_size=1, max_size=9)), max_size=4)
SOUND = (Content.indexed, Content.broken, Content.pending, Content.opaque)


def mutated(data: bytes, edits: list[tuple[float, bytes]], keep: float) -> bytes:
    changed = bytearray(data)
    for place, patch in edits:
        at = int(place * (len(data) - 1))
        changed[at : at + len(patch)] = patch
    return bytes(changed[: int(len(data) * keep)])


@given(st.sampled_from(MCAPS), EDITS, st.one_of(st.just(1.0), st.floats(0, 1)))
@settings(max_examples=400, deadline=2_000)
def test_mutated_mcap(data: bytes, edits: list[tuple[float, bytes]], keep: float) -> None:
    summary = summarise(MemorySource(mutated(data, edits, keep)))
    assert summary.content in SOUND
    assert (summary.message_count or 0) <= len(data) // 16
    assert (summary.content is Content.indexed) == (summary.reason is None)


@given(EDITS, st.one_of(st.just(1.0), st.floats(0, 1)))
@settings(max_examples=400, deadline=2_000)
def test_mutated_bag(edits: list[tuple[float, bytes]], keep: float) -> None:
    summary = summarise(MemorySource(mutated(BAG, edits, keep), "test.bag"))
    assert summary.content in SOUND
    assert (summary.message_count or 0) <= len(BAG) // 12
    assert (summary.content is Content.indexed) == (summary.reason is None)


def test_every_cut_of_an_mcap_is_broken() -> None:
    data = MCAPS[0]
    contents = {summarise(MemorySource(data[:length])).content for length in range(8, len(data))}
    assert contents == {Content.broken}
    assert summarise(MemorySource(data)).content is Content.indexed


def test_every_cut_of_a_bag_is_broken() -> None:
    contents = {summarise(MemorySource(BAG[:length], "test.bag")).content for length in range(13, len(BAG))}
    assert contents == {Content.broken}
    assert summarise(MemorySource(BAG, "test.bag")).content is Content.indexed
