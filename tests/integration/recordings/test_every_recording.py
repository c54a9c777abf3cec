"""Summary and scan of every real recording agree with independent readers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from kleinkram.recordings import Content, Depth, FileSource, RecordingFormat, RecordingSummary, TopicSummary, summarise
from kleinkram.recordings.isolation import from_dict, to_dict
from kleinkram.recordings.sources import CountingSource, SourceReader
from kleinkram.recordings.summary import scan
from tests.recording_files.corpus import Entry, entries, params

ONLY_A_SCAN_SEES_IT = "derived/auv_zstd_bitflip_chunk2.mcap"
RECORDINGS = {
    "MCAP": RecordingFormat.mcap,
    "ROS1 bag 2.0": RecordingFormat.rosbag1,
    "ROS2 sqlite3 db3": RecordingFormat.rosbag2_db3,
    "file-zstd of ROS2 sqlite3 db3": RecordingFormat.rosbag2_db3,
    "file-zstd of MCAP": RecordingFormat.mcap,
    "PX4 ULog": RecordingFormat.ulog,
}
OTHERS = {
    "rosbag2 metadata.yaml": RecordingFormat.rosbag2_metadata,
    "empty file": RecordingFormat.empty,
}


@cache
def by_summary(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return summarise(source)


@cache
def by_scan(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return scan(SourceReader(source))


@pytest.mark.parametrize("read", [by_summary, by_scan])
@pytest.mark.parametrize("entry", [pytest.param(e, id=e.name) for e in entries() or (Entry("missing", None, {}),)])
def test_recording(entry: Entry, read: Callable[[Path], RecordingSummary], recordings_dir: Path) -> None:
    summary = read(recordings_dir / entry.name)
    if entry.format not in RECORDINGS:
        assert_no_recording(summary, entry)
    elif entry.broken is None or (read is by_summary and entry.name == ONLY_A_SCAN_SEES_IT):
        assert_whole(summary, entry)
    else:
        assert_saved(summary, entry)


def assert_whole(summary: RecordingSummary, entry: Entry) -> None:
    expected = entry.expected
    assert (summary.format, summary.content) == (RECORDINGS[entry.format], Content.indexed)
    assert summary.reason is None
    assert summary.lost is None
    if entry.name == ONLY_A_SCAN_SEES_IT:
        assert summary.message_count == expected["stats_message_count"]
        return
    assert summary.message_count == expected["messages"]
    assert (summary.start_ns, summary.end_ns) == (expected["start_ns"], expected["end_ns"])
    assert facts_of(summary) == facts_expected(expected)
    assert set(expected.get("compression", [])) - {"unchunked", "none"} <= set(summary.compression)


def facts_of(summary: RecordingSummary) -> list[tuple[object, ...]]:
    return [(topic.name, topic.message_type, topic.count) for topic in summary.topics]


def facts_expected(expected: dict[str, Any]) -> list[tuple[object, ...]]:
    return sorted((topic["topic"], topic["type"], topic["count"]) for topic in expected["topics"])


def assert_saved(summary: RecordingSummary, entry: Entry) -> None:
    """At least what is known to be readable is found, and a person is told what is wrong."""
    expected = entry.expected
    readable = expected.get("messages_if_bad_chunk_skipped")
    readable = readable or expected.get("recoverable_by_linear_scan", expected).get("messages", 0)
    assert summary.content in (Content.recovered, Content.broken)
    assert summary.reason
    assert (summary.message_count or 0) >= readable
    assert (summary.content is Content.recovered) == bool(summary.message_count)


def assert_no_recording(summary: RecordingSummary, entry: Entry) -> None:
    assert summary.content is (Content.broken if entry.format == "empty file" else Content.opaque)
    assert summary.reason
    assert summary.problems == ()
    if entry.format in OTHERS:
        assert summary.format is OTHERS[entry.format]
    elif entry.name.endswith(".tum"):
        assert summary.format is RecordingFormat.tum
    else:
        assert entry.name.endswith(".json")


def test_the_manifest_lists_every_recording(recordings_dir: Path) -> None:
    """The manifest and the folder name the same files, so that the test above names each."""
    there = {path.relative_to(recordings_dir).as_posix() for path in recordings_dir.rglob("*") if path.is_file()}
    assert there - {"manifest.json"} == {entry.name for entry in entries()}


DETAILED = ("MCAP", "ROS1 bag 2.0")
"""Formats of which the manifest says all that a summary does."""

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
"""Lost chunks of the broken files, and lost messages where the file states their number."""

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
"""Quality warnings about whole recordings; all others have none."""


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


@pytest.mark.parametrize("entry", params(*DETAILED))
def test_undamaged_recordings_by_summary(entry: Entry, recordings_dir: Path) -> None:
    summary = by_summary(recordings_dir / entry.name)
    assert_as_expected(summary, entry)
    assert [problem.code for problem in summary.problems] == UNUSUAL.get(entry.name, [])


@pytest.mark.parametrize("entry", params(*DETAILED))
def test_undamaged_recordings_by_scan(entry: Entry, recordings_dir: Path) -> None:
    """A scan says the same as the index, and what only it can know."""
    scanned = by_scan(recordings_dir / entry.name)
    assert_as_expected(scanned, entry)
    assert scanned.depth is Depth.scan
    assert comparable(scanned) == comparable(by_summary(recordings_dir / entry.name))


def comparable(summary: RecordingSummary) -> tuple[TopicSummary, ...]:
    # An index does not say how long a message is, only where it begins.
    return tuple(replace(topic, stored_bytes=None) for topic in summary.topics)


@pytest.mark.parametrize("entry", params(*DETAILED, broken=True))
def test_broken_files_are_read_as_far_as_they_go(entry: Entry, recordings_dir: Path) -> None:
    summary = by_scan(recordings_dir / entry.name)
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
        summarised = by_summary(recordings_dir / entry.name)
        assert replace(summarised, bytes_read=summary.bytes_read) == summary


def test_trajectories_are_recognised(recordings_dir: Path) -> None:
    trajectories = sorted(recordings_dir.glob("trajectories/*.tum"))
    assert trajectories
    assert {by_summary(path).format for path in trajectories} == {RecordingFormat.tum}


def test_a_clock_that_jumps_is_seen_by_a_scan(recordings_dir: Path) -> None:
    """The log times of an hour earlier are told apart by the publish times, which only messages hold."""
    summary = by_scan(recordings_dir / "derived/auv_clock_jump_back.mcap")
    (problem,) = (p for p in summary.problems if p.code == "publish-time-differs")
    assert "-3600.0 s" in problem.message


def test_every_summary_survives_json(recordings_dir: Path) -> None:
    paths = [recordings_dir / entry.name for entry in entries() if entry.format in DETAILED]
    summaries = [read(path) for path in paths for read in (by_summary, by_scan)]
    assert [from_dict(json.loads(json.dumps(to_dict(summary)))) for summary in summaries] == summaries


def test_bytes_read_are_counted(recordings_dir: Path) -> None:
    with FileSource(recordings_dir / "mcap/SO_bag/SO_bag_0.mcap") as source:
        counting = CountingSource(source)
        assert summarise(counting).bytes_read == counting.bytes_read < 200_000
