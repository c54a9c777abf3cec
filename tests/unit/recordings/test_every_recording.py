"""Each of the real recordings comes out as independent readers found it: by summary and by scan, whole or broken."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from kleinkram.recordings import Content, FileSource, RecordingFormat, RecordingSummary, summarise
from kleinkram.recordings.sources import file_reader
from kleinkram.recordings.summary import scan

from .corpus import Entry, entries

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


def by_summary(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return summarise(source)


def by_scan(path: Path) -> RecordingSummary:
    with file_reader(path) as reader:
        return scan(reader)


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


def test_none_is_left_out(recordings_dir: Path) -> None:
    """The manifest and the folder name the same files, so that the test above names each."""
    there = {path.relative_to(recordings_dir).as_posix() for path in recordings_dir.rglob("*") if path.is_file()}
    assert there - {"manifest.json"} == {entry.name for entry in entries()}
