"""rosbag2 databases of every schema, intact, damaged and hostile."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import zstandard

from kleinkram.recordings import Content, Depth, Fact, Recording, RecordingFormat, RecordingSummary
from kleinkram.recordings.formats.rosbag2.db3 import scan_db3
from kleinkram.recordings.sources import FileSource, SourceReader
from tests.recording_files.corpus import Entry, params
from tests.recording_files.databases import SCHEMAS, T0, faults, make_database, steady


def scan_file(path: Path, depth: Depth = Depth.scan) -> RecordingSummary:
    with FileSource(path) as source:
        return scan_db3(SourceReader(source), depth=depth)


def change(path: Path, *statements: str) -> Path:
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        for statement in statements:
            database.execute(statement)
    return path


def counts(summary: RecordingSummary) -> dict[str, int | None]:
    return {topic.name: topic.count for topic in summary.topics}


@pytest.mark.parametrize("depth", Depth)
@pytest.mark.parametrize("entry", params("ROS2 sqlite3 db3"))
def test_real_databases(entry: Entry, depth: Depth, recordings_dir: Path) -> None:
    summary = scan_file(recordings_dir / entry.name, depth)
    expected = entry.expected
    assert (summary.format, summary.content, summary.reason) == (RecordingFormat.rosbag2_db3, Content.indexed, None)
    assert (summary.message_count, faults(summary.problems), summary.lost) == (expected["messages"], [], None)
    assert (summary.start_ns, summary.end_ns) == (expected["start_ns"], expected["end_ns"])
    actual = [(t.name, t.message_type, t.count, t.message_encoding) for t in summary.topics]
    assert actual == sorted((t["topic"], t["type"], t["count"], t.get("encoding", "")) for t in expected["topics"])
    assert (summary.depth, list(summary.compression)) == (depth, expected["compression"])


def test_the_real_damaged_database(recordings_dir: Path) -> None:
    """Half of 7396 messages: all those in the pages that are there, and no other."""
    summary = scan_file(recordings_dir / "derived/cut_vicon.db3")
    assert (summary.content, summary.message_count) == (Content.recovered, 3604)
    assert summary.reason == (
        "the file is cut: 526336 of 1052672 bytes are there; 3604 messages can be read, at least 3774 are lost"
    )
    assert counts(summary) == {"/vicon/UnitreeGo2/UnitreeGo2": 3604}
    assert (summary.start_ns, summary.topics[0].message_type) == (1764964008547998629, "vicon_receiver/msg/Position")
    whole = scan_file(recordings_dir / "ros2-db3/vicon_test6/rosbag2_2025_12_05-14_46_48_0.db3")
    assert summary.end_ns is not None
    assert whole.end_ns is not None
    assert summary.end_ns < whole.end_ns


@pytest.mark.parametrize("schema", SCHEMAS)
def test_every_schema(schema: str, tmp_path: Path) -> None:
    messages = steady(101)
    summary = scan_file(make_database(tmp_path / "a.db3", schema=schema, messages=messages))
    assert (summary.content, summary.reason, summary.problems) == (Content.indexed, None, ())
    assert (summary.start_ns, summary.end_ns, summary.message_count) == (T0, T0 + 1_000_000_000, 101)
    imu, fix = sorted(summary.topics, key=lambda topic: topic.name, reverse=True)
    assert (imu.name, imu.message_type, imu.count) == ("/imu", "sensor_msgs/msg/Imu", 51)
    assert (imu.rate_hz, imu.longest_gap_ns, imu.stored_bytes) == (50.0, 20_000_000, 51 * 200)
    assert (fix.count, fix.head_gap_ns, fix.tail_gap_ns) == (50, 10_000_000, 10_000_000)
    assert imu.message_encoding == ("" if schema == "crystal" else "cdr")


def test_no_messages(tmp_path: Path) -> None:
    summary = scan_file(make_database(tmp_path / "a.db3"))
    assert (summary.content, summary.message_count, summary.start_ns) == (Content.indexed, 0, None)
    assert counts(summary) == {"/imu": 0, "/fix": 0}


def test_messages_without_topic_are_counted_and_reported(tmp_path: Path) -> None:
    messages = [*steady(10), (7, T0, b"x"), (7, T0 + 5, b"x")]
    summary = scan_file(make_database(tmp_path / "a.db3", messages=messages))
    assert counts(summary) == {"/imu": 5, "/fix": 5, "(topic id 7)": 2}
    assert [(p.code, p.where) for p in summary.problems] == [("topic-undefined", "(topic id 7)")]


def test_two_rows_of_one_topic_are_one_topic(tmp_path: Path) -> None:
    path = make_database(tmp_path / "a.db3", topics=[("/a", "x/A"), ("/a", "x/B")], messages=steady(10))
    summary = scan_file(path)
    assert counts(summary) == {"/a": 10}
    assert [(p.code, p.where) for p in summary.problems] == [("topic-types-differ", "/a")]


def test_rows_that_are_no_messages_are_left_out(tmp_path: Path) -> None:
    bad = [(1, "noon", b""), (1, -5, b""), (1, 1.5, b""), ("x", T0, b""), (1, T0, "text")]
    summary = scan_file(make_database(tmp_path / "a.db3", messages=[*steady(4), *bad]))
    assert summary.message_count == 5
    (problem,) = [p for p in summary.problems if p.code == "rows-unusable"]
    assert problem.message.startswith("4 rows")


def test_disorder_and_suspect_stamps(tmp_path: Path) -> None:
    messages = [*steady(20, topics=1), (1, T0 + 5, b""), (1, 12, b"")]
    summary = scan_file(make_database(tmp_path / "a.db3", messages=messages))
    (topic,) = [topic for topic in summary.topics if topic.name == "/imu"]
    assert (topic.count, topic.out_of_order_count, topic.suspect_count) == (22, 2, 1)
    assert (summary.start_ns, summary.end_ns) == (T0, T0 + 190_000_000)


def test_large_messages_are_not_read_for_a_summary(tmp_path: Path) -> None:
    messages = [(1, T0 + number, b"x" * 20_000_000) for number in range(2)]
    path = make_database(tmp_path / "a.db3", messages=messages)
    for depth in Depth:
        summary = scan_file(path, depth)
        assert (summary.content, summary.reason, summary.message_count) == (Content.indexed, None, 2)
        assert summary.topics[-1].stored_bytes == 40_000_000


@pytest.mark.parametrize(
    ("statements", "named"),
    [
        (["DROP TABLE messages", "CREATE VIEW messages AS SELECT 1 topic_id, 2 timestamp, 3 data"], "it is a view"),
        (
            [
                "DROP TABLE messages",
                "CREATE TABLE messages(topic_id, timestamp, data AS (zeroblob(1000000000)))",
                "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1)",
            ],
            "no column data",
        ),
        (["DROP TABLE messages"], "it is missing"),
        (["ALTER TABLE topics RENAME COLUMN name TO title"], "no column name"),
    ],
)
def test_files_that_resemble_recordings_are_refused(statements: list[str], named: str, tmp_path: Path) -> None:
    summary = scan_file(change(make_database(tmp_path / "a.db3", messages=steady(5)), *statements))
    assert summary.content is Content.broken
    assert named in (summary.reason or "")


def test_code_of_a_database_does_not_run(tmp_path: Path) -> None:
    """A check with a function of its own: SQLite would run it while it checks every row."""
    path = change(
        make_database(tmp_path / "a.db3"),
        "DROP TABLE messages",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB,"
        " CHECK (length(hex(zeroblob(1000000000))) > 0))",
        "PRAGMA ignore_check_constraints=ON",
        "INSERT INTO messages VALUES (1, 1, 5, x'00')",
    )
    summary = scan_file(path)
    assert (summary.content, summary.message_count) == (Content.indexed, 1)


def test_queries_end_after_more_rows_than_the_file_has_room_for(tmp_path: Path) -> None:
    """A root page whose children are the root page: a tree without end."""
    path = make_database(tmp_path / "a.db3", messages=steady(2000))
    with closing(sqlite3.connect(path)) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    data = bytearray(path.read_bytes())
    start = (root - 1) * 4096
    cells = int.from_bytes(data[start + 3 : start + 5], "big")
    for number in range(cells):
        at = start + int.from_bytes(data[start + 12 + 2 * number : start + 14 + 2 * number], "big")
        data[at : at + 4] = root.to_bytes(4, "big")
    path.write_bytes(data)
    summary = scan_file(path)
    assert (summary.content, summary.message_count) == (Content.recovered, 2000)


@pytest.mark.parametrize("head", [b"", b"SQLite format 3\0", b"SQLite format 3\0" + bytes(84), bytes(5000)])
def test_a_database_without_readable_pages_is_broken(head: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    path.write_bytes(head)
    summary = scan_file(path)
    assert summary.content is Content.broken
    assert summary.reason
    assert summary.message_count in (None, 0)


def test_the_origin_of_a_database_is_reported(tmp_path: Path) -> None:
    """Where the messages are compressed each by itself, the database alone tells, and is read without metadata.yaml."""
    messages = [(1, T0 + number, zstandard.compress(bytes([number]) * 100)) for number in range(5)]
    path = make_database(tmp_path / "run_0.db3", schema="jazzy", messages=messages)
    stated = "compression_format: zstd\ncompression_mode: MESSAGE\nros_distro: jazzy\n"
    with closing(sqlite3.connect(path)) as database:
        database.execute("INSERT INTO schema VALUES (4, 'jazzy')")
        database.execute("INSERT INTO metadata VALUES (1, 9, 'compression_mode: NONE')")
        database.execute("INSERT INTO metadata VALUES (2, 9, ?)", (stated,))
        database.execute("INSERT INTO message_definitions VALUES (1, 'a/msg/B', 'ros2msg', 'int8 x', '')")
        database.commit()
    with FileSource(path) as source:
        summary = scan_db3(SourceReader(source))
    assert summary.compression == ("message-zstd",)
    assert summary.facts == (Fact("ros_distro", "jazzy"), Fact("schema_version", 4), Fact("message_definitions", 1))
    with Recording.open(path) as recording:
        assert [message.data for message in recording.raw_messages()] == [bytes([n]) * 100 for n in range(5)]
