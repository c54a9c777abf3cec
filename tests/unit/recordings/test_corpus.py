"""Every real MCAP and bag: what independent readers found in it is what its summary says, and what a scan says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from kleinkram.recordings import (
    Content,
    CountingSource,
    Depth,
    FileSource,
    RecordingFormat,
    RecordingSummary,
    TopicSummary,
    from_dict,
    summarise,
    to_dict,
)
from kleinkram.recordings.sources import file_reader
from kleinkram.recordings.summary import scan

from .corpus import Entry, entries, params

RECORDINGS = ("MCAP", "ROS1 bag 2.0")
ONLY_A_SCAN_SEES_IT = "derived/auv_zstd_bitflip_chunk2.mcap"  # its index is whole
FORMATS = {
    "rosbag2 metadata.yaml": (RecordingFormat.rosbag2_metadata, Content.opaque),
    "empty file": (RecordingFormat.empty, Content.broken),
}
LOST = {
    "broken/unindexed.bag": (0, None),
    "derived/magic_only.mcap": (0, None),
    "broken/truncated.bag": (1, None),
    "broken/truncated.mcap": (0, None),
    "derived/auv_zstd_bitflip_chunk2.mcap": (1, 1328),
    "derived/auv_zstd_cut_60pct.mcap": (0, None),
    "derived/auv_zstd_zero_tail.mcap": (0, None),
    "derived/cut_turtlesim_none.bag": (1, None),
}
"""Of the broken files: chunks, and messages where the file tells."""


_AUV = ["starts-late", "stops-early"]
UNUSUAL = {
    "mcap/rosbag2_all_sensor_msgs_none.mcap": ["silent-topic", "silent-topic"],
    "mcap/SO_bag/SO_bag_0.mcap": ["silent-topic", *_AUV],
    "derived/metadata_wrong_counts/SO_bag_0.mcap": ["silent-topic", *_AUV],
    "derived/auv_lz4.mcap": _AUV,
    "derived/auv_zstd.mcap": _AUV,
    "derived/auv_zstd_no_index.mcap": _AUV,
    "derived/auv_clock_jump_back.mcap": ["clock-jump"],
}
"""What is odd about whole recordings; about all others, nothing is."""


def summarise_file(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return summarise(source)


def scan_file(path: Path) -> RecordingSummary:
    with file_reader(path) as reader:
        return scan(reader)


def assert_as_expected(summary: RecordingSummary, entry: Entry) -> None:
    expected = entry.expected
    assert summary.content is Content.indexed
    assert summary.reason is None
    assert summary.lost is None
    assert summary.message_count == expected["messages"]
    assert (summary.start_ns, summary.end_ns) == (expected["start_ns"], expected["end_ns"])
    if entry.format == "MCAP":
        assert summary.format is RecordingFormat.mcap
        actual = [(t.name, t.message_type, t.count, t.message_encoding, t.schema_encoding) for t in summary.topics]
        expected_topics = [
            (t["topic"], t["type"], t["count"], t["encoding"], t.get("schema_encoding", "")) for t in expected["topics"]
        ]
        assert actual == sorted(expected_topics)
        assert (summary.library, summary.profile) == (expected["library"], expected["profile"])
        assert summary.attachments == expected["attachments"]
        assert summary.metadata_records == expected["metadata_records"]
    else:
        assert summary.format is RecordingFormat.rosbag1
        found_bag = [(t.name, t.message_type, t.count, t.message_encoding) for t in summary.topics]
        assert found_bag == sorted((t["topic"], t["type"], t["count"], t["encoding"]) for t in expected["topics"])
    assert list(summary.compression) == [name for name in expected["compression"] if name != "unchunked"]


@pytest.mark.parametrize("entry", params(*RECORDINGS))
def test_whole_by_summary(entry: Entry, recordings_dir: Path) -> None:
    summary = summarise_file(recordings_dir / entry.name)
    assert_as_expected(summary, entry)
    assert [problem.code for problem in summary.problems] == UNUSUAL.get(entry.name, [])


@pytest.mark.parametrize("entry", params(*RECORDINGS))
def test_whole_by_scan(entry: Entry, recordings_dir: Path) -> None:
    """A scan says the same as the index, and what only it can know."""
    by_scan = scan_file(recordings_dir / entry.name)
    assert_as_expected(by_scan, entry)
    assert by_scan.depth is Depth.scan
    by_index = summarise_file(recordings_dir / entry.name)
    assert comparable(by_scan) == comparable(by_index)


def comparable(summary: RecordingSummary) -> tuple[TopicSummary, ...]:
    # An index does not say how long a message is, only where it begins.
    return tuple(replace(topic, stored_bytes=None) for topic in summary.topics)


@pytest.mark.parametrize("entry", params(*RECORDINGS, broken=True))
def test_broken_files_are_read_as_far_as_they_go(entry: Entry, recordings_dir: Path) -> None:
    summary = scan_file(recordings_dir / entry.name)
    expected = entry.expected
    linear = expected.get("recoverable_by_linear_scan", expected)
    readable = expected.get("messages_if_bad_chunk_skipped", linear["messages"])
    assert summary.message_count is not None
    assert summary.message_count >= readable
    assert summary.content is (Content.recovered if summary.message_count else Content.broken)
    assert summary.reason is not None
    assert f"{summary.message_count} messages can be read" in summary.reason
    lost = (summary.lost.chunks, summary.lost.messages) if summary.lost else None
    assert lost == LOST.get(entry.name)
    if entry.name != ONLY_A_SCAN_SEES_IT:
        by_summary = summarise_file(recordings_dir / entry.name)
        assert replace(by_summary, bytes_read=summary.bytes_read) == summary


@pytest.mark.parametrize("entry", params(*FORMATS) + params(*FORMATS, broken=True))
def test_other_formats_are_recognised(entry: Entry, recordings_dir: Path) -> None:
    for summary in (summarise_file(recordings_dir / entry.name), scan_file(recordings_dir / entry.name)):
        assert (summary.format, summary.content) == FORMATS[entry.format]
        assert summary.reason
        assert summary.problems == ()


def test_trajectories_are_recognised(recordings_dir: Path) -> None:
    trajectories = sorted(recordings_dir.glob("trajectories/*.tum"))
    assert trajectories
    assert {summarise_file(path).format for path in trajectories} == {RecordingFormat.tum}


def test_a_clock_that_jumps_is_seen_by_a_scan(recordings_dir: Path) -> None:
    """The log times of an hour earlier are told apart by the publish times, which only messages hold."""
    summary = scan_file(recordings_dir / "derived/auv_clock_jump_back.mcap")
    (problem,) = (p for p in summary.problems if p.code == "publish-time-differs")
    assert "-3600.0 s" in problem.message


def test_every_summary_survives_json(recordings_dir: Path) -> None:
    paths = [recordings_dir / entry.name for entry in entries() if entry.format in RECORDINGS]
    summaries = [read(path) for path in paths for read in (summarise_file, scan_file)]
    assert [from_dict(json.loads(json.dumps(to_dict(summary)))) for summary in summaries] == summaries


def test_bytes_read_are_counted(recordings_dir: Path) -> None:
    with FileSource(recordings_dir / "mcap/SO_bag/SO_bag_0.mcap") as source:
        counting = CountingSource(source)
        assert summarise(counting).bytes_read == counting.bytes_read < 200_000
