"""Selecting messages by topic, pattern and time, and the bytes read for it."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from kleinkram.recordings import NoSuchTopic, Recording, SeveralRecordings
from kleinkram.recordings.formats.mcap.format import read_index
from kleinkram.recordings.sample import generate_db3, generate_mcap
from tests.recording_files.builders import T0, Stamped, Watched, bag_of, mcap_of
from tests.recording_files.memory_source import MemorySource

Make = Callable[[Iterable[Iterable[Stamped]]], MemorySource]
MAKERS = [pytest.param(mcap_of, id="mcap"), pytest.param(bag_of, id="bag")]
CHUNK_BYTES = 30_000


def drive(chunks: int = 40) -> list[list[Stamped]]:
    """Return chunks of 10 ms each; /rare is in every tenth."""
    noise = bytes(range(256)) * (CHUNK_BYTES // 256)
    made: list[list[Stamped]] = []
    for number in range(chunks):
        made.append([("/camera/left", T0 + number * 10, noise), ("/camera/right", T0 + number * 10 + 5, b"r")])
        if number % 10 == 0:
            made[-1].append(("/rare", T0 + number * 10 + 7, b"rare"))
    return made


@pytest.mark.parametrize("make", MAKERS)
def test_start_is_inclusive_and_end_exclusive(make: Make) -> None:
    recording = Recording.open(make(drive()))
    stamps = [m.log_time_ns - T0 for m in recording.raw_messages(start=T0 + 10, end=T0 + 25)]
    assert stamps == [10, 15, 20]


def test_times_may_be_datetimes(tmp_path: Path) -> None:
    moment = datetime.datetime(2024, 5, 1, 12, 0, 0, 250_000, tzinfo=datetime.timezone.utc)
    moment_ns = 1_714_564_800_250_000_000
    recording = Recording.open(mcap_of([[("/t", moment_ns - 1, b"a"), ("/t", moment_ns, b"b")]]))
    assert [m.data for m in recording.raw_messages(start=moment)] == [b"b"]
    assert [m.data for m in recording.raw_messages(end=moment)] == [b"a"]
    with pytest.raises(ValueError, match="time zone"):
        recording.raw_messages(start=moment.replace(tzinfo=None))


@pytest.mark.parametrize(
    ("topics", "actual"),
    [
        ("/rare", {"/rare"}),
        ("/camera/*", {"/camera/left", "/camera/right"}),
        (["/rare", "*left"], {"/rare", "/camera/left"}),
        ("/nothing*", set()),
        (None, {"/camera/left", "/camera/right", "/rare"}),
    ],
)
def test_topics_by_name_and_glob(topics: str | list[str] | None, actual: set[str]) -> None:
    recording = Recording.open(mcap_of(drive()))
    assert {m.topic for m in recording.raw_messages(topics)} == actual


def test_an_unknown_topic_is_named_with_those_there_are() -> None:
    recording = Recording.open(mcap_of(drive(3)))
    with pytest.raises(NoSuchTopic, match=r"/camera/up; the recording has /camera/left, /camera/right, /rare"):
        recording.raw_messages("/camera/up")


@pytest.mark.parametrize("make", MAKERS)
def test_properties_come_from_the_index(make: Make) -> None:
    watched = Watched(make(drive()))
    recording = Recording.open(watched)
    assert {topic.name: topic.count for topic in recording.topics} == {
        "/camera/left": 40,
        "/camera/right": 40,
        "/rare": 4,
    }
    assert (recording.message_count, recording.start_ns, recording.end_ns) == (84, T0, T0 + 395)


@pytest.mark.parametrize("parallel_reads", [1, 8])
def test_no_chunk_without_the_topic_is_read(parallel_reads: int) -> None:
    source = mcap_of(drive(400), name="large.mcap")
    rows = list(read_index(source).table.rows)
    watched = Watched(source, parallel_reads=parallel_reads)
    recording = Recording.open(watched)
    opened_with = watched.bytes_read
    assert opened_with < 100_000
    watched.ranges.clear()
    actual = list(recording.raw_messages("/rare", start=T0 + 1000, end=T0 + 2000))
    assert len(actual) == 10
    expected_names = [row for number, row in enumerate(rows) if number % 10 == 0 and 100 <= number < 200]
    assert watched.bytes_read == sum(row.length for row in expected_names)
    others = [row for row in rows if row not in expected_names]
    assert not any(watched.touched(row.start, row.start + row.length) for row in others)


@pytest.mark.parametrize("parallel_reads", [1, 8])
def test_one_frame_costs_one_chunk(parallel_reads: int) -> None:
    watched = Watched(mcap_of(drive(), name="large.mcap"), parallel_reads=parallel_reads)
    recording = Recording.open(watched)
    watched.ranges.clear()
    messages = recording.raw_messages("/camera/left", start=T0 + 100)
    assert next(messages).log_time_ns == T0 + 100
    del messages
    assert len(watched.ranges) == 1


def test_consecutive_frames_are_fetched_in_large_ranges() -> None:
    watched = Watched(mcap_of(drive(200)), parallel_reads=8)
    recording = Recording.open(watched)
    watched.ranges.clear()
    assert len(list(recording.raw_messages("/camera/*"))) == 400
    assert len(watched.ranges) < 20
    assert watched.bytes_read < watched.size_bytes


def test_folder_file_and_metadata_open_the_same(tmp_path: Path) -> None:
    truth = generate_db3(tmp_path / "drive", duration_s=0.5)
    folder = tmp_path / "drive"
    counts = []
    for what in (folder, str(folder), folder / "metadata.yaml", folder / "drive_0.db3"):
        with Recording.open(what) as recording:
            counts.append(sum(1 for _ in recording.raw_messages()))
    assert counts == [truth.message_count] * 4


def test_a_folder_of_several_recordings_names_them(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        generate_mcap(tmp_path / name, duration_s=0.2)
    with pytest.raises(SeveralRecordings, match=r"2 recordings.*a\.mcap, .*b\.mcap"):
        Recording.open(tmp_path)


def test_selecting_what_does_not_exist_is_refused() -> None:
    with pytest.raises(FileNotFoundError, match="no such file or folder"):
        Recording.open("/nowhere/at/all.mcap")
