"""The real recordings: the same messages, with the same bytes, as public readers give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mcap import records
from mcap.stream_reader import StreamReader
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag2 import Reader as Rosbag2Reader

from kleinkram.recordings import NotARecording, Recording
from kleinkram.recordings.inspect import inspect_paths
from tests.recording_files.corpus import Entry, entries, params

Plain = tuple[str, int, bytes]
ROSBAG2_REFUSES = {"old_schema": 7, "wrong_rmw_db3": 7, "split_missing_file": 4834, "talker": 20}
"""Folders that the `rosbags` library does not read, or reads nothing of, and the messages that they hold."""

READABLE = {
    "broken/truncated.bag": 3,
    "broken/unindexed.bag": 14,
    "broken/truncated.mcap": 14,
    "derived/auv_zstd_bitflip_chunk2.mcap": 1343,
    "derived/auv_zstd_cut_60pct.mcap": 2360,
    "derived/auv_zstd_zero_tail.mcap": 2671,
    "derived/magic_only.mcap": 0,
    "derived/cut_turtlesim_none.bag": 4899,
}
"""Messages of whole chunks by the manifest; of a bag's only chunk that is cut, what stands before the cut."""


def read(path: Path) -> tuple[list[Plain], tuple[Any, ...]]:
    with Recording.open(path) as recording:
        actual = [(message.topic, message.log_time_ns, message.data) for message in recording.raw_messages()]
        assert recording.message_count in (None, len(actual))
        for topic in recording.topics:
            assert topic.count in (None, sum(name == topic.name for name, _, _ in actual))
        return actual, recording.problems


def codes_of_summary(path: Path) -> list[str]:
    """Return the codes that `klein inspect` names: oddities that are no fault of the reader's."""
    (inspection,) = inspect_paths([path])
    return [problem.code for problem in inspection.summary.problems]


def read_with_mcap(path: Path) -> list[Plain]:
    actual: list[Plain] = []
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, records.Channel):
                topics[record.id] = record.topic
            elif isinstance(record, records.Message):
                actual.append((topics[record.channel_id], record.log_time, record.data))
    return sorted(actual, key=lambda message: message[1])


@pytest.mark.parametrize("entry", params("MCAP"))
def test_mcap(entry: Entry, recordings_dir: Path) -> None:
    messages, problems = read(recordings_dir / entry.name)
    assert messages == read_with_mcap(recordings_dir / entry.name)
    assert [problem.code for problem in problems] == codes_of_summary(recordings_dir / entry.name)


@pytest.mark.parametrize("entry", params("ROS1 bag 2.0"))
def test_bag(entry: Entry, recordings_dir: Path) -> None:
    messages, problems = read(recordings_dir / entry.name)
    with BagReader(recordings_dir / entry.name) as reader:
        expected = [(connection.topic, stamp, data) for connection, stamp, data in reader.messages()]
    assert messages == expected
    assert [problem.code for problem in problems] == codes_of_summary(recordings_dir / entry.name)


def folders() -> list[Any]:
    names = sorted({Path(entry.name).parent for entry in entries() if entry.name.endswith("metadata.yaml")})
    return [pytest.param(name, id=str(name)) for name in names if name.name != "metadata_only_data_missing"] or [
        pytest.param(Path("recordings are missing"), id="none")
    ]


@pytest.mark.parametrize("folder", folders())
def test_rosbag2_folder(folder: Path, recordings_dir: Path) -> None:
    messages, problems = read(recordings_dir / folder)
    if folder.name in ROSBAG2_REFUSES:
        assert len(messages) == ROSBAG2_REFUSES[folder.name]
        assert [problem.code for problem in problems] == codes_of_summary(recordings_dir / folder)
        return
    with Rosbag2Reader(recordings_dir / folder) as reader:
        expected = [(connection.topic, stamp, data) for connection, stamp, data in reader.messages()]
    assert messages == expected
    assert [problem.code for problem in problems] == codes_of_summary(recordings_dir / folder)


@pytest.mark.parametrize("entry", params("file-zstd of MCAP", "file-zstd of ROS2 sqlite3 db3", "ROS2 sqlite3 db3"))
def test_single_database_or_compressed_file(entry: Entry, recordings_dir: Path) -> None:
    messages, _ = read(recordings_dir / entry.name)
    assert len(messages) == entry.expected["messages"]
    assert [stamp for _, stamp, _ in messages] == sorted(stamp for _, stamp, _ in messages)


@pytest.mark.parametrize("entry", params("MCAP", "ROS1 bag 2.0", broken=True))
def test_broken_files_give_what_is_readable(entry: Entry, recordings_dir: Path) -> None:
    with Recording.open(recordings_dir / entry.name) as recording:
        stamps = [message.log_time_ns for message in recording.raw_messages()]
        assert recording.problems
    assert len(stamps) == READABLE[entry.name]
    assert stamps == sorted(stamps)


def test_cut_database(recordings_dir: Path) -> None:
    """Every message whose pages are there, with its bytes, in order."""
    whole, _ = read(recordings_dir / "ros2-db3/vicon_test6")
    others, _ = read(recordings_dir / "ros2-db3/vicon_standard2")
    messages, problems = read(recordings_dir / "derived/cut_vicon.db3")
    assert len(messages) == 3604
    assert set(messages) <= {*whole, *others}
    assert [stamp for _, stamp, _ in messages] == sorted(stamp for _, stamp, _ in messages)
    assert {problem.code for problem in problems} == {"damaged"}


def test_empty_file(recordings_dir: Path) -> None:
    with pytest.raises(NotARecording, match="0 bytes"):
        Recording.open(recordings_dir / "broken/zero_length.bag")


def test_metadata_without_data(recordings_dir: Path) -> None:
    with pytest.raises(NotARecording, match="names a data file with 27792 messages, but none is there"):
        Recording.open(recordings_dir / "broken/metadata_only_data_missing")
