"""Content checks of positions, odometry, transforms and batteries."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from kleinkram.recordings.recording_files import Openable
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros1_bag, ros2_mcap
from tests.unit.checks.content_checks import ERROR, NOT_MADE, OK, only, run, statuses

WRITERS = pytest.mark.parametrize("write", [ros1_bag, ros2_mcap])
Write = Callable[..., Openable]


def series(
    topic: str, message_type: str, values: Callable[[int], dict[str, Any]], count: int = 100
) -> list[TimedMessage]:
    """Return messages at 10 Hz."""
    times = [T0 + number * SECOND // 10 for number in range(count)]
    return [TimedMessage(topic, message_type, time_ns, values(number), time_ns) for number, time_ns in enumerate(times)]


def fixes(values: Callable[[int], dict[str, Any]]) -> list[TimedMessage]:
    def fix(number: int) -> dict[str, Any]:
        return {"status": {"status": 0}, "latitude": 47.4 + number * 1e-6, "longitude": 8.5, **values(number)}

    return series("/gps/fix", "sensor_msgs/NavSatFix", fix)


POSITIONS = "positions: {/gps/fix: {}}"


@WRITERS
def test_good_positions_pass(write: Write) -> None:
    rows = run(POSITIONS, write(fixes(lambda _n: {})))
    assert statuses(rows) == {"position.fix": OK, "position.jump": OK}
    assert only(rows, "position.jump").value == pytest.approx(1.11, rel=0.01)  # 1e-6 degrees in 0.1 s


@WRITERS
@pytest.mark.parametrize("lost", [{"status": {"status": -1}}, {"latitude": math.nan}, {"latitude": 0, "longitude": 0}])
def test_a_lost_fix_is_found(lost: dict[str, Any], write: Write) -> None:
    rows = run(POSITIONS, write(fixes(lambda number: lost if number >= 80 else {})))
    row = only(rows, "position.fix")
    assert (row.status, row.value, row.limit, row.time_ns) == (ERROR, 0.8, 0.95, T0 + 8 * SECOND)
    assert only(rows, "position.jump").status is OK


def test_a_jump_of_the_position_is_found() -> None:
    rows = run(POSITIONS, ros2_mcap(fixes(lambda number: {"longitude": 8.6} if number == 50 else {})))
    row = only(rows, "position.jump")
    assert (row.status, row.limit, row.unit, row.time_ns) == (ERROR, 100, "m/s", T0 + 5 * SECOND)


def test_a_receiver_that_never_had_a_fix_has_no_jumps() -> None:
    rows = statuses(run(POSITIONS, ros2_mcap(fixes(lambda _n: {"status": {"status": -1}}))))
    assert rows == {"position.fix": ERROR, "position.jump": NOT_MADE}


def odometry(position: Callable[[int], float], angle: Callable[[int], float] = lambda _n: 0) -> list[TimedMessage]:
    def pose(number: int) -> dict[str, Any]:
        half = angle(number) / 2
        orientation = {"z": math.sin(half), "w": math.cos(half)}
        return {"pose": {"pose": {"position": {"x": position(number)}, "orientation": orientation}}}

    return series("/odom", "nav_msgs/Odometry", pose)


ODOMETRY = "odometry: {/odom: {}}"


@WRITERS
def test_good_odometry_passes(write: Write) -> None:
    (row,) = run(ODOMETRY, write(odometry(lambda number: 0.1 * number, lambda number: 0.05 * number)))
    assert (row.status, row.name) == (OK, "odometry.jump")


@WRITERS
def test_jumps_of_odometry_are_found(write: Write) -> None:
    (row,) = run(ODOMETRY, write(odometry(lambda number: 0.1 * number + (5 if number >= 40 else 0))))
    assert (row.status, row.unit, row.time_ns) == (ERROR, "m/s", T0 + 4 * SECOND)
    assert row.value == pytest.approx(51)
    (row,) = run(ODOMETRY, write(odometry(lambda _n: 0, lambda number: 2 if number >= 40 else 0)))
    assert (row.status, row.unit) == (ERROR, "rad/s")
    assert row.value == pytest.approx(20)


def test_poses_and_transforms_are_odometry_too() -> None:
    stamped = series("/pose", "geometry_msgs/PoseStamped", lambda n: {"pose": {"position": {"x": 9.0 * (n == 50)}}})
    assert run("odometry: {/pose: {}}", ros2_mcap(stamped))[0].status is ERROR
    moved = series(
        "/transform", "geometry_msgs/TransformStamped", lambda n: {"transform": {"translation": {"y": 9.0 * (n == 50)}}}
    )
    assert run('odometry: {"/t*": {}}', ros2_mcap(moved))[0].status is ERROR


def test_odometry_of_nan_is_never_green() -> None:
    (row,) = run(ODOMETRY, ros2_mcap(odometry(lambda _n: math.nan)))
    assert (row.status, row.message) == (NOT_MADE, "all poses are NaN or infinite")
    (row,) = run(ODOMETRY, ros2_mcap(odometry(lambda number: math.nan if number < 51 else 0.1 * number)))
    assert (row.status, row.message) == (NOT_MADE, "51 of 100 poses have no value")
    (row,) = run(ODOMETRY, ros2_mcap(odometry(lambda number: math.nan if number < 50 else 0.1 * number)))
    assert row.status is OK
    (row,) = run(ODOMETRY, ros2_mcap(odometry(lambda number: math.nan if number < 51 else 9.0 * number)))
    assert row.status is ERROR


def tf(topic: str, *frames: tuple[str, str]) -> Iterator[TimedMessage]:
    for number in range(20):
        transforms = [
            {"header": {"frame_id": parent}, "child_frame_id": child, "transform": {"rotation": {"w": 1}}}
            for parent, child in frames
        ]
        yield TimedMessage(topic, "tf2_msgs/TFMessage", T0 + number * SECOND // 10, {"transforms": transforms})


TRANSFORMS = "transforms: {'/tf*': {}}"


@WRITERS
def test_one_tree_over_several_topics_and_recordings_passes(write: Write) -> None:
    first = write([*tf("/tf", ("map", "odom"), ("odom", "base_link"))])
    second = write([*tf("/tf_static", ("/base_link", "lidar"), ("base_link", "imu"))])
    (row,) = run(TRANSFORMS, first, second)
    assert (row.status, row.message, row.topic) == (OK, "5 frames make one tree", "/tf, /tf_static")


@WRITERS
def test_a_tree_that_is_not_connected_is_found(write: Write) -> None:
    (row,) = run(TRANSFORMS, write([*tf("/tf", ("map", "odom")), *tf("/tf_static", ("base_link", "lidar"))]))
    assert (row.status, row.value) == (ERROR, 2)
    assert row.message == "the frames make 2 trees that are not connected: base_link, lidar; map, odom"


def test_a_frame_that_is_missing_is_found() -> None:
    rules = "transforms: {/tf: {frames: [map, base_link, camera]}}"
    (row,) = run(rules, ros2_mcap(tf("/tf", ("map", "odom"), ("odom", "base_link"))))
    assert (row.status, row.message) == (ERROR, "no transform has the frame camera")


def test_messages_without_transforms_are_not_made() -> None:
    (row,) = run(TRANSFORMS, ros2_mcap(tf("/tf")))
    assert (row.status, row.message) == (NOT_MADE, "there is no transform")


def battery(**values: float) -> list[TimedMessage]:
    return series(
        "/battery", "sensor_msgs/BatteryState", lambda number: {k: v - number * 0.001 * v for k, v in values.items()}
    )


@WRITERS
def test_a_low_battery_is_found(write: Write) -> None:
    rules = "batteries: {/battery: {min_percentage: 20%, min_voltage: 22}}"
    good = run(rules, write(battery(percentage=0.8, voltage=25)))
    assert [row.status for row in good] == [OK, OK]
    low = run(rules, write(battery(percentage=0.21, voltage=25)))
    assert [(row.status, row.unit) for row in low] == [(ERROR, None), (OK, "V")]
    assert low[0].message == "its lowest state of charge is 19%"
    assert low[0].time_ns == T0 + 99 * SECOND // 10


def test_a_percentage_of_100_is_recognised() -> None:
    (row,) = run("batteries: {/battery: {min_percentage: 20%}}", ros2_mcap(battery(percentage=80)))
    assert row.status is OK
    assert row.value == pytest.approx(0.72, abs=0.01)


def test_a_battery_that_does_not_measure_is_not_made() -> None:
    (row,) = run("batteries: {/battery: {min_voltage: 20}}", ros2_mcap(battery(voltage=math.nan)))
    assert (row.status, row.message) == (NOT_MADE, "its voltage is not measured")
