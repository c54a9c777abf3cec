"""Every real recording: what independent readers found in it is what the summary says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kleinkram.recordings import (
    Content,
    CountingSource,
    FileSource,
    RecordingFormat,
    RecordingSummary,
    from_dict,
    summarise,
    to_dict,
)
from kleinkram.recordings.assemble import TopicType, measure
from kleinkram.recordings.mcap.scan import scan_mcap
from kleinkram.recordings.timeline import Timeline

from .corpus import Entry, entries, params

ONLY_A_SCAN_SEES_IT = "derived/auv_zstd_bitflip_chunk2.mcap"  # its index is whole
FORMATS = {
    "ROS2 sqlite3 db3": (RecordingFormat.rosbag2_db3, Content.pending),
    "file-zstd of ROS2 sqlite3 db3": (RecordingFormat.zstd, Content.pending),
    "file-zstd of MCAP": (RecordingFormat.zstd, Content.pending),
    "rosbag2 metadata.yaml": (RecordingFormat.rosbag2_metadata, Content.opaque),
    "PX4 ULog": (RecordingFormat.ulog, Content.opaque),
    "empty file": (RecordingFormat.empty, Content.broken),
}


def summarise_file(path: Path) -> RecordingSummary:
    with FileSource(path) as source:
        return summarise(source)


def assert_as_expected(summary: RecordingSummary, entry: Entry) -> None:
    expected = entry.expected
    assert summary.content is Content.indexed
    assert summary.reason is None
    assert summary.message_count == expected["messages"]
    assert (summary.start_ns, summary.end_ns) == (expected["start_ns"], expected["end_ns"])
    found = [(t.name, t.message_type, t.count, t.message_encoding) for t in summary.topics]
    assert found == sorted((t["topic"], t["type"], t["count"], t["encoding"]) for t in expected["topics"])
    assert list(summary.compression) == [name for name in expected["compression"] if name != "unchunked"]


@pytest.mark.parametrize("entry", params("MCAP"))
def test_mcap(entry: Entry, recordings_dir: Path) -> None:
    summary = summarise_file(recordings_dir / entry.name)
    assert_as_expected(summary, entry)
    assert summary.format is RecordingFormat.mcap
    assert summary.problems == ()
    assert (summary.library, summary.profile) == (entry.expected["library"], entry.expected["profile"])
    assert summary.attachments == entry.expected["attachments"]
    assert summary.metadata_records == entry.expected["metadata_records"]
    encodings = {t["topic"]: t.get("schema_encoding", "") for t in entry.expected["topics"]}
    assert {t.name: t.schema_encoding for t in summary.topics} == encodings


@pytest.mark.parametrize("entry", params("ROS1 bag 2.0"))
def test_bag(entry: Entry, recordings_dir: Path) -> None:
    summary = summarise_file(recordings_dir / entry.name)
    assert_as_expected(summary, entry)
    assert summary.format is RecordingFormat.rosbag1
    assert summary.problems == ()


@pytest.mark.parametrize("entry", params("MCAP", "ROS1 bag 2.0", broken=True, without=ONLY_A_SCAN_SEES_IT))
def test_broken_files_say_why(entry: Entry, recordings_dir: Path) -> None:
    summary = summarise_file(recordings_dir / entry.name)
    assert summary.content is Content.broken
    assert summary.reason
    assert "byte " in summary.reason
    if entry.format == "MCAP":
        assert summary.message_count == entry.expected["messages"]


@pytest.mark.parametrize("entry", params(*FORMATS) + params(*FORMATS, broken=True))
def test_other_formats_are_recognised(entry: Entry, recordings_dir: Path) -> None:
    summary = summarise_file(recordings_dir / entry.name)
    assert (summary.format, summary.content) == FORMATS[entry.format]
    assert summary.reason
    assert summary.problems == ()


def test_trajectories_are_recognised(recordings_dir: Path) -> None:
    trajectories = sorted(recordings_dir.glob("trajectories/*.tum"))
    assert trajectories
    assert {summarise_file(path).format for path in trajectories} == {RecordingFormat.tum}


@pytest.mark.parametrize("entry", params("MCAP"))
def test_scan_and_index_agree(entry: Entry, recordings_dir: Path) -> None:
    """Two ways of reading one file give the same topics, gaps and disorder."""
    by_index = summarise_file(recordings_dir / entry.name)
    timeline = Timeline()
    with FileSource(recordings_dir / entry.name) as source:
        scan = scan_mcap(source, timeline)
    assert scan.damage == []
    assert scan.ended is None
    by_scan = measure(timeline, {name: [TopicType("", "", "")] for name in timeline.topics})
    times = {
        t.name: (t.count, t.first_ns, t.last_ns, t.longest_gap_ns, t.out_of_order_count, t.head_gap_ns, t.tail_gap_ns)
        for t in by_index.topics
        if t.count
    }
    assert times == {
        t.name: (t.count, t.first_ns, t.last_ns, t.longest_gap_ns, t.out_of_order_count, t.head_gap_ns, t.tail_gap_ns)
        for t in by_scan.topics
    }


def test_scan_finds_a_flipped_byte(recordings_dir: Path) -> None:
    (entry,) = (e for e in entries() if e.name == ONLY_A_SCAN_SEES_IT)
    timeline = Timeline()
    with FileSource(recordings_dir / entry.name) as source:
        scan = scan_mcap(source, timeline)
    assert sum(times.count for times in timeline.topics.values()) == entry.expected["messages_if_bad_chunk_skipped"]
    assert len([fault for fault in scan.damage if fault.where.startswith("chunk at byte")]) == 1


def test_every_summary_survives_json(recordings_dir: Path) -> None:
    files = [path for path in sorted(recordings_dir.rglob("*")) if path.is_file()]
    summaries = [summarise_file(path) for path in files]
    assert [from_dict(json.loads(json.dumps(to_dict(summary)))) for summary in summaries] == summaries


def test_bytes_read_are_counted(recordings_dir: Path) -> None:
    with FileSource(recordings_dir / "mcap/SO_bag/SO_bag_0.mcap") as source:
        counting = CountingSource(source)
        assert summarise(counting).bytes_read == counting.bytes_read < 200_000
