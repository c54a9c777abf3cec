"""Content checks as a whole: which topics rules apply to, what is read, and what cannot be read."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.checks.content import OpenRecording, check_content
from kleinkram.checks.content.segment_plan import plan_visits, plan_whole, sample_times
from kleinkram.checks.document import read_checks
from kleinkram.contract.checks import MAX_CHECKS
from kleinkram.recordings import Recording
from kleinkram.recordings.formats.base import Segment
from tests.recording_files.builders import Watched, mcap_of
from tests.recording_files.databases import make_database
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, encode, ros1_bag, ros2_db3, ros2_mcap
from tests.unit.checks.content_checks import ERROR, NOT_MADE, OK, only, run, statuses

IMU = "imu: {/imu: {}}"


def imu(seconds: float = 10, rate_hz: int = 50, topic: str = "/imu") -> Iterator[TimedMessage]:
    for number in range(int(seconds * rate_hz)):
        wobble = 0.01 * (number % 7 - 3)
        vectors = dict.fromkeys("xyz", wobble)
        values = {"linear_acceleration": {**vectors, "z": 9.81 + wobble}, "angular_velocity": vectors}
        time_ns = T0 + number * SECOND // rate_hz
        yield TimedMessage(topic, "sensor_msgs/Imu", time_ns, values, time_ns)


def ballast(seconds: int, size: int = 4096) -> Iterator[TimedMessage]:
    """Large messages that no rule is about, at 50 Hz."""
    for number in range(seconds * 50):
        time_ns = T0 + number * SECOND // 50 + 1
        data = bytes((number * 31 + place * place) % 251 for place in range(64)) * (size // 64)
        yield TimedMessage("/other", "sensor_msgs/CompressedImage", time_ns, {"data": data}, time_ns)


def by_time(*streams: Iterator[TimedMessage]) -> list[TimedMessage]:
    return sorted((message for stream in streams for message in stream), key=lambda message: message.log_ns)


def test_a_rule_that_matches_no_topic_is_not_made() -> None:
    rows = run("imu: {'/foot/*': {}}", ros2_mcap(imu()))
    assert {(row.status, row.topic, row.message) for row in rows} == {(NOT_MADE, "/foot/*", "no topic matches /foot/*")}


def test_without_recordings_nothing_is_green() -> None:
    rows = run("imu: {/imu: {}}\nimages: {'*': {}}")
    assert {row.status for row in rows} == {NOT_MADE}
    assert run("topics: {/imu: {rate: 50}}") == []


def test_a_recording_that_could_not_be_opened_is_never_green() -> None:
    profiles = read_checks("version: 1\nprofiles: [{imu: {/imu: {}}}]").profiles
    with Recording.open(ros2_mcap(imu())) as recording:
        broken = OpenRecording("jetson", None, "the file is cut")
        rows = check_content(profiles, [OpenRecording("nuc", recording), broken])
        assert {(row.file, row.status) for row in rows} == {("nuc", OK), ("jetson", NOT_MADE)}
        rows = check_content(profiles, [broken])
        assert {row.message for row in rows} == {"no topic matches /imu; jetson could not be read: the file is cut"}


def test_without_the_extra_reading_the_checks_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numpy", None)
    rows = run(IMU, ros2_mcap(imu()))
    assert {row.status for row in rows} == {NOT_MADE}
    assert {row.message for row in rows} == {"this needs numpy: run `pip install 'open-kleinkram[reading]'`"}


def test_all_rules_of_a_topic_apply() -> None:
    rows = run("imu: {/imu: [{gravity: 1.62, severity: warning}, {}], '/i*': {}}", ros2_mcap(imu()))
    gravity = [row.status.value for row in rows if row.name == "imu.gravity"]
    assert gravity == ["warning", "ok", "ok"]


def test_samples_are_spread_and_only_their_chunks_are_read() -> None:
    messages = by_time(imu(200), ballast(200))
    source = Watched(ros2_mcap(messages, chunk_bytes=2**16))
    with Recording.open(source) as recording:
        chunks = len(recording.segments())
    source.ranges.clear()
    rows = run(IMU, source, budget_bytes=source.size_bytes // 8)
    assert set(statuses(rows).values()) == {OK}
    assert chunks > 400
    assert source.bytes_read < source.size_bytes // 4


def test_the_two_formats_of_chunks_and_databases_agree(tmp_path: Path) -> None:
    messages = by_time(imu(4), ballast(4, 256))
    expected = run(IMU, ros2_mcap(messages))
    assert run(IMU, ros1_bag(messages)) == expected
    assert run(IMU, ros2_db3(messages, tmp_path / "bag")) == expected
    assert set(statuses(expected).values()) == {OK}


def test_a_rare_topic_of_a_database_is_found(tmp_path: Path) -> None:
    rare = [TimedMessage("/imu", "sensor_msgs/Imu", T0 + SECOND + 7, {"linear_acceleration": {"z": 3}}, T0)]
    folder = ros2_db3(by_time(ballast(4, 2048), iter(rare)), tmp_path / "bag")
    row = only(run(IMU, folder, budget_bytes=1), "imu.gravity")
    assert (row.status, row.value) == (ERROR, 3)


def test_a_database_without_index_of_times(tmp_path: Path) -> None:
    messages = [(1, T0 + n, encode("sensor_msgs/Imu", {"linear_acceleration": {"z": 5 + n % 2}})) for n in range(100)]
    path = make_database(
        tmp_path / "old.db3", schema="dashing", topics=[("/imu", "sensor_msgs/msg/Imu")], messages=messages
    )
    assert only(run(IMU, path), "imu.gravity").status is ERROR


def test_a_topic_without_messages_is_not_made(tmp_path: Path) -> None:
    path = make_database(tmp_path / "empty.db3", messages=[])
    rows = run(IMU, path)
    assert {row.status for row in rows} == {NOT_MADE}


def test_an_undecodable_topic_is_not_made() -> None:
    source = mcap_of([[("/imu", T0 + n, b"\x00\x01\x00\x00") for n in range(5)]])
    rows = run(f"{IMU}\nvalues: {{/imu: {{}}}}", source)
    assert {row.status for row in rows} == {NOT_MADE}
    assert all("cannot be decoded" in row.message for row in rows)


def test_messages_that_do_not_fit_their_type_are_counted() -> None:
    good = list(imu(2))
    data = ros2_mcap(good)
    with Recording.open(data) as recording:
        raw = list(recording.raw_messages())
    cut = [(message.topic, message.log_time_ns, message.data[: None if n % 2 else 40]) for n, message in enumerate(raw)]
    path = mcap_of([cut])
    rows = run("values: {/imu: {}}", path)
    assert {row.status for row in rows} == {NOT_MADE}


def test_a_chunk_that_cannot_be_read_is_not_ignored() -> None:
    source = ros2_mcap(imu(60, 200), chunk_bytes=2**14)
    data = bytearray(source.read(0, source.size_bytes))
    middle = len(data) // 2
    data[middle : middle + 4096] = bytes(4096)
    rows = run(IMU, MemorySource(bytes(data), "test.mcap"))
    assert only(rows, "imu.constant").status is OK
    assert any(row.status is NOT_MADE and "a part of the messages could not be read" in row.message for row in rows)


@pytest.mark.parametrize("damage", ["cut", "flipped", "hole"])
def test_broken_recordings_break_nothing(damage: str) -> None:
    messages = by_time(imu(20), ballast(20, 1024))
    data = bytearray(ros2_mcap(messages, chunk_bytes=2**14).read(0, ros2_mcap(messages, chunk_bytes=2**14).size_bytes))
    if damage == "cut":
        del data[len(data) * 6 // 10 :]
    elif damage == "flipped":
        for at in range(1000, len(data) - 20_000, len(data) // 50):
            data[at] ^= 0x40
    else:
        data[len(data) // 3 : len(data) // 2] = bytes(len(data) // 2 - len(data) // 3)
    rows = run(IMU, MemorySource(bytes(data)))
    gravity = [row.status for row in rows if row.name == "imu.gravity"]
    # What is left of it is good, and what could not be read is not; the index of a cut file says nothing of the rest.
    assert gravity == ([OK] if damage == "cut" else [OK, NOT_MADE])


def test_many_topics_are_bounded() -> None:
    rules = "clocks: {'*': [{max_stamp_offset: 1s}, {max_stamp_jump: 1s}]}"
    topics = [TimedMessage(f"/t{number}", "sensor_msgs/Imu", T0 + number, {}, T0) for number in range(6000)]
    rows = run(rules, ros2_mcap(topics, chunk_bytes=2**20))
    assert len(rows) == MAX_CHECKS + 1
    assert rows[-1].status is NOT_MADE
    assert rows[-1].message == f"2000 topics of rules were left out: at most {MAX_CHECKS} are checked"


def test_names_that_cannot_be_stored_are_left_out() -> None:
    topic = "/imu\x00" + "x" * 2000
    source = mcap_of([[(topic, T0, b"")]])
    (row,) = run("values: {'*': {}}", source)
    assert row.topic is not None
    assert len(row.topic) <= 1024


def segments(count: int, size: int, topics: frozenset[str] | None = frozenset({"/a"})) -> list[Segment]:
    return [Segment(n * 100, n * 100 + 99, size, topics, (0, n)) for n in range(count)]


def test_a_plan_to_read_everything_has_samples_too() -> None:
    visits = plan_whole(segments(10, 5), {"/a": 4})
    assert [visit.segment.order[1] for visit in visits] == list(range(10))
    assert sum(len(visit.targets["/a"]) for visit in visits) == 4


def test_beyond_the_budget_samples_share_segments() -> None:
    both, one = frozenset({"/a", "/b"}), frozenset({"/a"})
    parts = [Segment(n * 100, n * 100 + 99, 10, both if n % 2 else one, (0, n)) for n in range(1000)]
    visits = plan_visits(parts, {"/a": 20, "/b": 20}, 0, 300)
    assert len(visits) == 20
    assert all(visit.segment.topics == both for visit in visits)
    assert visits[0].segment.order[1] < 5
    assert visits[-1].segment.order[1] > 995


def test_a_small_budget_gives_fewer_samples_spread_over_the_recording() -> None:
    visits = plan_visits(segments(1000, 10), {"/a": 20}, 0, 60)
    assert 2 <= len(visits) <= 6
    assert visits[-1].segment.order[1] - visits[0].segment.order[1] > 900
    assert len(plan_visits(segments(1000, 10), {"/a": 20}, 0, 1)) == 1


def test_fewer_segments_give_several_samples_each() -> None:
    visits = plan_visits(segments(1000, 10), {"/a": 20}, 0, 100)
    assert 8 <= len(visits) <= 10
    assert sum(len(visit.targets["/a"]) for visit in visits) >= 20
    assert all(
        visit.segment.first_ns <= time_ns <= visit.segment.last_ns
        for visit in visits
        for time_ns in visit.targets["/a"]
    )


def test_samples_far_apart_come_in_pairs() -> None:
    assert sample_times(0, 100, 5, 0) == [0, 25, 50, 75, 100]
    assert sample_times(0, 1000, 8, 10) == [0, 10, 330, 340, 660, 670, 990, 1000]
    assert sample_times(0, 100, 6, 20) == [0, 20, 40, 60, 80, 100]
    assert sample_times(7, 7, 20, 0) == [7]


def test_of_very_many_messages_those_around_samples_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kleinkram.checks.content.run.READ_WHOLE_MESSAGES", 100)
    monkeypatch.setattr("kleinkram.checks.content.sample_reader._AROUND", 4)
    source = ros2_mcap(imu(60, 200), chunk_bytes=2**14)
    row = only(run("clocks: {/imu: {max_stamp_offset: 1ms}}\nimu: {/imu: {}}", source), "clock.stamp_offset")
    assert row.status is OK
    measured = int(row.message.split("median of ")[1].rstrip(")"))
    assert 20 <= measured <= 200


def test_hostile_times_break_nothing() -> None:
    last = 2**64 - 1
    source = mcap_of([[("/imu", 1, b"\0\1\0\0")], [("/imu", last, encode("sensor_msgs/Imu", {}))]])
    assert run(IMU, source)
