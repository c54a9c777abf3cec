"""Segments: the parts of a recording that are read as a whole, to look into a large one."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from kleinkram.recordings import NoSuchTopic, Recording
from kleinkram.recordings.recording_files import Openable
from tests.recording_files.builders import T0, Stamped, Watched, bag_of, mcap_of
from tests.recording_files.databases import make_database, steady
from tests.recording_files.memory_source import MemorySource

CHUNKS: list[list[Stamped]] = [
    [("/a", T0 + 100 * chunk + step, bytes(50)) for step in range(5)]
    + ([("/b", T0 + 100 * chunk + 7, b"b")] if chunk % 2 else [])
    for chunk in range(6)
]


@pytest.mark.parametrize("write", [mcap_of, bag_of])
def test_segments_are_chunks_with_their_topics(write: object) -> None:
    source = write(CHUNKS)  # type: ignore[operator]  # either of two functions
    with Recording.open(source) as recording:
        segments = recording.segments()
        assert [segment.first_ns for segment in segments] == [T0 + 100 * chunk for chunk in range(6)]
        assert [segment.topics for segment in segments] == [frozenset({"/a"}), frozenset({"/a", "/b"})] * 3
        assert 0 < sum(segment.size_bytes for segment in segments) < source.size_bytes
        assert [segment.order[1] for segment in recording.segments("/b")] == [
            segment.order[1] for segment in segments[1::2]
        ]


def test_reading_a_segment_reads_no_other_chunk() -> None:
    source = Watched(mcap_of(CHUNKS))
    with Recording.open(source) as recording:
        segments = recording.segments("/b")
        source.ranges.clear()
        (block,) = recording.segment_messages(segments[1], ["/b"])
        assert [(message.topic, message.log_time_ns) for message in block] == [("/b", T0 + 307)]
        assert source.bytes_read <= segments[1].size_bytes


def _all_messages(recording: Recording) -> list[tuple[str, int, bytes]]:
    blocks = [block for segment in recording.segments() for block in recording.segment_messages(segment)]
    return [(message.topic, message.log_time_ns, message.data) for block in blocks for message in block]


@pytest.mark.parametrize("schema", ["dashing", "humble"])
def test_the_segments_of_a_database_have_each_message_once(schema: str, tmp_path: Path) -> None:
    path = make_database(tmp_path / "a.db3", schema=schema, messages=steady(3000, size=100))
    with Recording.open(path) as recording:
        assert len(recording.segments()) == 1  # below 1 MB
        expected = [(message.topic, message.log_time_ns, message.data) for message in recording.raw_messages()]
        assert _all_messages(recording) == expected
        assert len(expected) == 3000


def test_slices_of_a_database_cover_its_span(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kleinkram.recordings.formats.rosbag2.db3._SLICE_BYTES", 10_000)
    path = make_database(tmp_path / "a.db3", messages=steady(1000))
    with Recording.open(path) as recording:
        segments = recording.segments()
        assert len(segments) > 20
        assert all(later.first_ns == earlier.last_ns + 1 for earlier, later in pairwise(segments))
        assert len(_all_messages(recording)) == 1000


def test_a_recording_without_messages_has_no_segments(tmp_path: Path) -> None:
    for source in (mcap_of([]), make_database(tmp_path / "a.db3")):
        with Recording.open(source) as recording:
            assert recording.segments() == []


def test_a_name_that_is_no_topic_is_refused() -> None:
    with Recording.open(mcap_of(CHUNKS)) as recording, pytest.raises(NoSuchTopic):
        recording.segments(["/none"])


def test_the_segments_of_several_files_are_in_the_order_of_time() -> None:
    sources: list[MemorySource] = [
        mcap_of(CHUNKS[3:], name="run_1.mcap"),
        mcap_of(CHUNKS[:3], name="run_0.mcap"),
    ]
    opened: Openable = sources
    with Recording.open(opened) as recording:
        assert [segment.first_ns for segment in recording.segments()] == [T0 + 100 * chunk for chunk in range(6)]
        assert len(_all_messages(recording)) == sum(map(len, CHUNKS))


def test_a_damaged_chunk_is_reported_and_the_others_are_read() -> None:
    whole = mcap_of(CHUNKS)
    with Recording.open(whole) as recording:
        places = [segment.size_bytes for segment in recording.segments()]
    data = bytearray(whole.read(0, whole.size_bytes))
    data[data.index(b"zstd") + 4 + 8 + 30] ^= 0xFF
    with Recording.open(MemorySource(bytes(data))) as recording:
        assert len(recording.segments()) == len(places)
        assert len(_all_messages(recording)) >= sum(map(len, CHUNKS[1:]))
        assert recording.problems
