"""Content checks of clocks: header stamps against log times, and one topic recorded by two computers."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

import pytest

from kleinkram.recordings.recording_files import Openable
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros1_bag, ros2_mcap
from tests.unit.checks.content_checks import ERROR, NOT_MADE, OK, only, run, statuses

RULES = "clocks: {/imu: {max_stamp_offset: 50ms, max_stamp_drift: 200, max_stamp_jump: 100ms}}"
WRITERS = pytest.mark.parametrize("write", [ros1_bag, ros2_mcap])
MS = 1_000_000


def stamped(
    stamp_error_ns: Callable[[float], float] = lambda _seconds: 0,
    *,
    seconds: int = 20,
    start_ns: int = T0,
    log_offset_ns: int = 0,
    topic: str = "/imu",
    seed: int = 1,
) -> Iterator[TimedMessage]:
    """Yield measurements at 50 Hz that are recorded 1 to 4 ms later."""
    chance = random.Random(seed)
    for number in range(seconds * 50):
        true_ns = start_ns + number * SECOND // 50
        stamp_ns = true_ns + round(stamp_error_ns(number / 50))
        log_ns = true_ns + round(chance.uniform(1, 4) * MS) + log_offset_ns
        yield TimedMessage(topic, "sensor_msgs/Imu", log_ns, {}, stamp_ns)


@WRITERS
def test_good_clocks_pass(write: Callable[..., Openable]) -> None:
    rows = run(RULES, write(stamped()))
    assert statuses(rows) == {"clock.stamp_offset": OK, "clock.stamp_drift": OK, "clock.stamp_jump": OK}
    assert only(rows, "clock.stamp_offset").value == pytest.approx(-0.0025, abs=0.0005)


@WRITERS
@pytest.mark.parametrize("offset_ms", [-300, 300])
def test_an_offset_of_stamps_is_found(offset_ms: int, write: Callable[..., Openable]) -> None:
    rows = run(RULES, write(stamped(lambda _s: offset_ms * MS)))
    row = only(rows, "clock.stamp_offset")
    assert (row.status, row.limit, row.unit) == (ERROR, 0.05, "s")
    assert row.value == pytest.approx(offset_ms / 1000, abs=0.01)
    assert only(rows, "clock.stamp_drift").status is OK
    assert only(rows, "clock.stamp_jump").status is OK


@WRITERS
def test_a_drift_of_stamps_is_found(write: Callable[..., Openable]) -> None:
    rows = run(RULES, write(stamped(lambda seconds: seconds * 1e6)))  # 1 ms/s
    drift = only(rows, "clock.stamp_drift")
    assert (drift.status, drift.unit) == (ERROR, "ppm")
    assert drift.value == pytest.approx(1000, rel=0.05)
    assert only(rows, "clock.stamp_offset").status is OK


def test_jitter_of_a_short_recording_is_no_drift() -> None:
    assert only(run(RULES, ros2_mcap(stamped(seconds=2))), "clock.stamp_drift").status is OK
    short = run(RULES, ros2_mcap([*stamped(seconds=1)][:5]))
    assert only(short, "clock.stamp_drift").status is NOT_MADE


def test_a_jump_of_stamps_is_found_where_it_is() -> None:
    rows = run(RULES, ros2_mcap(stamped(lambda seconds: 0 if seconds < 12 else -800 * MS)))
    jump = only(rows, "clock.stamp_jump")
    assert jump.status is ERROR
    assert jump.value == pytest.approx(-0.8, abs=0.01)
    assert jump.time_ns == pytest.approx(T0 + 12 * SECOND, abs=10 * MS)


def test_stamps_of_zero_are_found() -> None:
    messages = [TimedMessage("/imu", "sensor_msgs/Imu", T0 + n * SECOND, {}, 0) for n in range(5)]
    assert only(run(RULES, ros2_mcap(messages)), "clock.stamp_offset").status is ERROR


def test_messages_without_stamp() -> None:
    texts = [TimedMessage("/chatter", "std_msgs/String", T0 + n * SECOND, {"data": "hello"}) for n in range(5)]
    (row,) = run("clocks: {/chatter: {max_stamp_offset: 1s}}", ros2_mcap(texts))
    assert (row.status, row.message) == (NOT_MADE, "its messages have no header stamp")
    (row,) = run('clocks: {"*": {max_stamp_offset: 1s}}', ros2_mcap(texts))
    assert (row.status, row.topic) == (NOT_MADE, "*")
    mixed = sorted([*texts, *stamped(seconds=4)], key=lambda message: message.log_ns)
    (row,) = run('clocks: {"*": {max_stamp_offset: 1s}}', ros2_mcap(mixed))
    assert (row.status, row.topic) == (OK, "/imu")


def test_a_rule_about_jumps_of_the_log_time_reads_nothing() -> None:
    assert run('clocks: {"*": {no_jump: true}}', ros2_mcap(stamped(seconds=1))) == []


TWO = "clocks: {/imu: {max_recorder_offset: 20ms}}"


@WRITERS
def test_two_recorders_that_agree_pass(write: Callable[..., Openable]) -> None:
    (row,) = run(TWO, write(stamped()), write(stamped(seed=2)))
    assert (row.status, row.file) == (OK, "b")


@WRITERS
@pytest.mark.parametrize("offset_ms", [-2500, 100])
def test_the_offset_between_two_recorders_is_found(offset_ms: int, write: Callable[..., Openable]) -> None:
    (row,) = run(TWO, write(stamped()), write(stamped(seed=2, log_offset_ns=offset_ms * MS)))
    assert (row.status, row.limit, row.unit) == (ERROR, 0.02, "s")
    assert row.value == pytest.approx(offset_ms / 1000, abs=0.005)
    assert row.message.startswith(f"b recorded it {'2.5 s earlier' if offset_ms < 0 else '1'}"[:20])


def test_the_offset_is_found_by_samples_of_recordings_that_are_not_read_whole() -> None:
    first = ros2_mcap(stamped(seconds=120), chunk_bytes=4096)
    second = ros2_mcap(stamped(seconds=100, start_ns=T0 + 10 * SECOND, log_offset_ns=5 * SECOND), chunk_bytes=4096)
    budget = (first.size_bytes + second.size_bytes) // 4
    (row,) = run(TWO, first, second, budget_bytes=budget)
    assert row.status is ERROR
    assert row.value == pytest.approx(5, abs=0.005)


def test_messages_without_stamp_are_matched_by_their_bytes() -> None:
    def texts(offset_ns: int) -> Iterator[TimedMessage]:
        for number in range(30):
            yield TimedMessage("/log", "std_msgs/String", T0 + number * SECOND + offset_ns, {"data": f"event {number}"})
            yield TimedMessage("/log", "std_msgs/String", T0 + number * SECOND + offset_ns + 1, {"data": "tick"})

    rules = "clocks: {/log: {max_recorder_offset: 20ms}}"
    (row,) = run(rules, ros2_mcap(texts(0)), ros2_mcap(texts(400 * MS)))
    assert (row.status, row.value) == (ERROR, 0.4)
    assert "30 messages" in row.message


def test_transforms_are_matched_too() -> None:
    def transforms(offset_ns: int) -> Iterator[TimedMessage]:
        for number in range(100):
            seconds, rest = divmod(T0 + number * SECOND // 10, SECOND)
            header = {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": "odom"}
            values = {"transforms": [{"header": header, "child_frame_id": "base"}]}
            yield TimedMessage("/tf", "tf2_msgs/TFMessage", T0 + number * SECOND // 10 + offset_ns, values)

    rules = "clocks: {/tf: {max_recorder_offset: 20ms}}"
    (row,) = run(rules, ros2_mcap(transforms(0)), ros2_mcap(transforms(70 * MS)))
    assert (row.status, row.value) == (ERROR, 0.07)


def test_a_topic_of_one_recording_has_no_offset() -> None:
    (row,) = run(TWO, ros2_mcap(stamped(seconds=2)))
    assert (row.status, row.message) == (NOT_MADE, "no two recordings have a topic that matches /imu")


def test_recordings_that_share_no_message_are_not_made() -> None:
    (row,) = run(TWO, ros2_mcap(stamped(seconds=2)), ros2_mcap(stamped(seconds=2, start_ns=T0 + 90 * SECOND)))
    assert row.status is NOT_MADE
    assert "no message of it is in the samples of both a and b" in row.message
