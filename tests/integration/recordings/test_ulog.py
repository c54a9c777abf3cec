"""PX4 flight logs (ULog): summary, scan, messages with their fields, and damage."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from kleinkram.recordings import Content, FileSource, Recording, RecordingFormat, TooCostly, summarise
from kleinkram.recordings.formats.ulog import SYNC_MAGIC, as_ros1_definition
from kleinkram.recordings.inspect import inspect_paths
from tests.integration.recordings.test_other_formats import facts, summarise_text
from tests.memory import call_within
from tests.recording_files.agreement import accounts_of, disagreements
from tests.recording_files.corpus import Entry, params
from tests.recording_files.memory_source import MemorySource

START_US = 1_000_000
ATTITUDE = b"attitude:uint64_t timestamp;float[4] q;vector[2] rates;bool valid;uint8_t[7] _padding0;"
VECTOR = b"vector:float x;int16_t y;uint8_t[2] _padding0;"


def ulog(*messages: tuple[str, bytes]) -> bytes:
    body = b"".join(struct.pack("<HB", len(data), ord(kind)) + data for kind, data in messages)
    return b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000) + body


def data_message(message_id: int, *values: int) -> tuple[str, bytes]:
    return "D", struct.pack(f"<H{len(values)}Q", message_id, *values)


def attitude(number: int) -> bytes:
    """Return the data of a message: padding at its end is not logged, padding inside of it is."""
    vectors = b"".join(struct.pack("<fhxx", number + index / 2, -number) for index in range(2))
    return struct.pack("<Q4f", START_US + number * 1000, 1, 0, 0, number) + vectors + bytes([number % 2])


def subscription(message_id: int, name: str, instance: int = 0) -> tuple[str, bytes]:
    return "A", struct.pack("<BH", instance, message_id) + name.encode()


def attitude_log(count: int, *, sync_every: int = 10) -> bytes:
    messages: list[tuple[str, bytes]] = [("F", VECTOR), ("F", ATTITUDE)]
    messages += [subscription(5, "attitude"), subscription(6, "attitude", 1)]
    for number in range(count):
        messages.append(("D", struct.pack("<H", 5 + number % 2) + attitude(number)))
        if number % sync_every == sync_every - 1:
            messages.append(("S", SYNC_MAGIC))
    return ulog(*messages)


def write(folder: Path, data: bytes) -> Path:
    path = folder / "flight.ulg"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("entry", params("PX4 ULog"))
def test_real_flight_log(entry: Entry, recordings_dir: Path) -> None:
    with FileSource(recordings_dir / entry.name) as source:
        summary = summarise(source)
    expected = entry.expected
    assert (summary.format, summary.content, summary.reason) == (RecordingFormat.ulog, Content.indexed, None)
    assert summary.message_count == expected["messages"]
    assert {problem.code for problem in summary.problems} <= {"stamps-before-start"}
    assert bool(summary.problems) == (entry.name == "other/px4_sample.ulg")
    assert (summary.start_ns, summary.end_ns) == (expected["start_ns"], expected["end_ns"])
    actual = [(t.name, t.message_type, t.count) for t in summary.topics]
    assert actual == sorted((t["topic"], t["type"], t["count"]) for t in expected["topics"])
    assert facts(summary)["sys_name"] == "PX4"


def test_a_flight_log_that_was_cut(recordings_dir: Path) -> None:
    data = (recordings_dir / "other/px4_sample.ulg").read_bytes()
    previous = -1
    for tenth in range(1, 10):
        summary = summarise(MemorySource(data[: len(data) * tenth // 10], "a.ulg"))
        assert summary.content in (Content.recovered, Content.indexed, Content.broken)
        assert summary.message_count is not None
        assert previous <= summary.message_count < 4272
        previous = summary.message_count
    assert previous > 3000


def test_the_stamp_of_a_flight_log_may_stand_anywhere() -> None:
    log = ulog(
        ("F", b"a:uint32_t[2] pair;uint64_t timestamp;"),
        ("F", b"b:other nested;uint64_t timestamp;"),
        ("A", b"\x00\x05\x00a"),
        ("A", b"\x02\x06\x00b"),
        data_message(5, 7, 2_000_000),
        data_message(5, 7, 3_000_000),
        data_message(5, 7, 500_000),
        data_message(6, 7, 3_000_000),
        data_message(9, 1),
        ("O", struct.pack("<H", 120)),
        ("I", b"\x10char[3] sys_nameABC"),
    )
    summary = summarise_text(log, "a.ulg")
    assert [(t.name, t.count, t.first_ns, t.last_ns) for t in summary.topics] == [
        ("a", 3, 1_000_000_000, 3_000_000_000),
    ]
    assert [p.code for p in summary.problems] == ["dropouts", "rows-unusable", "stamps-before-start", "topic-undefined"]
    assert (facts(summary)["sys_name"], facts(summary)["topics_without_message"]) == ("ABC", 1)


@pytest.mark.parametrize("kind", "ABCDFILMOPQRS")
def test_empty_messages_of_a_flight_log(kind: str) -> None:
    summary = summarise_text(ulog((kind, b"")), "a.ulg")
    assert (summary.content, summary.message_count) == (Content.indexed, 0)


@pytest.mark.parametrize("tail", [b"\xff" * 50, b"\x00" * 50, b"\x10\x00Dab"])
def test_a_flight_log_with_rubbish_at_its_end(tail: bytes) -> None:
    log = ulog(("F", b"a:uint64_t timestamp;"), ("A", b"\x00\x05\x00a"), data_message(5, 2_000_000))
    summary = summarise(MemorySource(log + tail, "a.ulg"))
    assert (summary.content, summary.message_count) == (Content.recovered, 1)
    assert summary.reason
    assert summary.lost is not None


def test_messages_are_decoded_by_their_format(tmp_path: Path) -> None:
    with Recording.open(write(tmp_path, attitude_log(100))) as recording:
        assert [(topic.name, topic.message_type, topic.count) for topic in recording.topics] == [
            ("attitude", "attitude", 50),
            ("attitude#1", "attitude", 50),
        ]
        assert (recording.start_ns, recording.end_ns) == (START_US * 1000, (START_US + 99_000) * 1000)
        messages = list(recording.messages())
    assert [message.log_time_ns for message in messages] == [(START_US + n * 1000) * 1000 for n in range(100)]
    value = messages[7].value
    assert (value.timestamp, list(value.q), value.valid) == (START_US + 7000, [1, 0, 0, 7], True)
    assert [(rate.x, rate.y) for rate in value.rates] == [(7, -7), (7.5, -7)]
    assert messages[7].schema.data == ATTITUDE + b"\n" + VECTOR


def test_topics_and_times_are_selected(tmp_path: Path) -> None:
    with Recording.open(write(tmp_path, attitude_log(100))) as recording:
        start = (START_US + 10_000) * 1000
        actual = list(recording.messages("attitude#1", start=start, end=start + 10_000_000))
    assert [message.value.q[3] for message in actual] == [11, 13, 15, 17, 19]


def test_a_topic_is_a_table(tmp_path: Path) -> None:
    with Recording.open(write(tmp_path, attitude_log(20))) as recording:
        frame = recording.to_pandas("attitude")
    assert list(frame["timestamp"]) == [START_US + n * 1000 for n in range(0, 20, 2)]
    assert list(frame["valid"]) == [False] * 10


def test_messages_come_in_the_order_of_time() -> None:
    log = ulog(
        ("F", b"a:uint64_t timestamp;"),
        subscription(1, "a"),
        subscription(2, "a", 1),
        *(data_message(1 + n % 2, START_US + (n * 37) % 1000) for n in range(1000)),
    )
    with Recording.open(MemorySource(log, "a.ulg")) as recording:
        times = [message.log_time_ns for message in recording.raw_messages()]
    assert times == [(START_US + n) * 1000 for n in range(1000)]


@pytest.mark.parametrize("at", [0.3, 0.6, 0.9])
def test_reading_goes_on_behind_damage_at_the_next_sync_message(at: float, tmp_path: Path) -> None:
    data = bytearray(attitude_log(1000))
    place = int(len(data) * at)
    data[place : place + 200] = b"\xff" * 200
    path = write(tmp_path, bytes(data))
    (inspection,) = inspect_paths([path])
    summary = inspection.summary
    assert summary.content is Content.recovered
    assert summary.message_count is not None
    assert 970 <= summary.message_count < 1000
    assert summary.lost is not None
    assert 0 < summary.lost.bytes < 2000
    with Recording.open(path) as recording:
        assert sum(1 for _ in recording.messages()) == summary.message_count
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []


@pytest.mark.parametrize("tenth", range(1, 10))
def test_a_cut_log_keeps_what_stands_before_the_cut(tenth: int, tmp_path: Path) -> None:
    whole = attitude_log(100)
    write(tmp_path, whole[: len(whole) * tenth // 10])
    (accounts,) = accounts_of(tmp_path)
    assert disagreements(accounts) == []
    assert accounts.scan.count is not None
    assert 10 * (tenth - 1) - 5 <= accounts.scan.count <= 10 * tenth


def test_appended_data_are_read_behind_a_cut_message() -> None:
    """A crash dump is appended while the last message before it is not whole."""
    before = ulog(
        ("B", bytes(8) + b"\x01" + bytes(7) + bytes(24)),
        ("F", b"a:uint64_t timestamp;"),
        subscription(1, "a"),
        data_message(1, START_US),
    )
    cut = struct.pack("<HBH", 10, ord("D"), 1) + b"abc"
    offset = len(before) + len(cut)
    at = before.index(b"\x01" + bytes(31)) + 8
    data = bytearray(before + cut + ulog(data_message(1, START_US + 5))[16:])
    data[at : at + 8] = struct.pack("<Q", offset)
    summary = summarise(MemorySource(bytes(data), "a.ulg"))
    assert summary.message_count == 2
    with Recording.open(MemorySource(bytes(data), "a.ulg")) as recording:
        assert [message.value.timestamp for message in recording.messages()] == [START_US, START_US + 5]


def test_a_log_of_a_later_version_is_refused() -> None:
    summary = summarise_text(ulog(("B", bytes(8) + b"\x02" + bytes(7) + bytes(24))), "a.ulg")
    assert summary.content is Content.opaque
    assert "later version" in (summary.reason or "")


def test_a_log_over_a_network_is_read_only_up_to_a_limit() -> None:
    source = MemorySource(attitude_log(100), "a.ulg")
    assert summarise(source, max_bytes=10).content is Content.pending
    with pytest.raises(TooCostly):
        Recording.open(source, max_bytes=10)


@pytest.mark.parametrize(
    "fields", ["a:a inner;uint64_t timestamp;", "a:uint64_t timestamp;missing x;", "a:uint64_t timestamp;nonsense"]
)
def test_formats_that_cannot_be_followed_leave_bytes(fields: str) -> None:
    log = ulog(("F", fields.encode()), subscription(1, "a"), data_message(1, START_US))
    with Recording.open(MemorySource(log, "a.ulg")) as recording:
        assert all(isinstance(message.value, bytes) or fields.endswith("nonsense") for message in recording.messages())


def test_memory_does_not_follow_the_size_of_the_log(tmp_path: Path) -> None:
    path = tmp_path / "large.ulg"
    head = ulog(("F", b"a:uint64_t timestamp;uint8_t[60000] noise;"), subscription(1, "a"))
    with path.open("wb") as file:
        file.write(head)
        for number in range(1500):
            data = struct.pack("<HQ", 1, START_US + number) + bytes(60_000)
            file.write(struct.pack("<HB", len(data), ord("D")) + data)
    assert path.stat().st_size > 80 * 2**20
    with FileSource(path) as source:
        count = call_within(40 * 2**20, lambda: sum(1 for _ in Recording.open(source).raw_messages()))
    assert count == 1500


def test_a_real_flight_log_is_decoded(recordings_dir: Path) -> None:
    path = recordings_dir / "other/px4_sample.ulg"
    with FileSource(path) as source:
        summary = summarise(source)
    with Recording.open(path) as recording:
        assert {topic.name: topic.count for topic in recording.topics} == {t.name: t.count for t in summary.topics}
        assert [topic.name for topic in recording.topics if topic.undecodable] == []
        count = 0
        for message in recording.messages():
            assert not isinstance(message.value, bytes), message.topic
            count += 1
        attitudes = [message.value for message in recording.messages("vehicle_attitude")]
    assert count == summary.message_count
    assert all(abs(sum(part * part for part in value.q) - 1) < 1e-3 for value in attitudes)


def test_a_format_is_written_as_a_ros_definition() -> None:
    text = as_ros1_definition("attitude", ATTITUDE + b"\n" + VECTOR).decode()
    top, nested = text.split(f"\n{'=' * 80}\n")
    assert top.splitlines() == ["uint64 timestamp", "float32[4] q", "ulog/vector[2] rates", "bool valid"]
    assert nested.splitlines() == ["MSG: ulog/vector", "float32 x", "int16 y", "uint8[2] padding0_"]
