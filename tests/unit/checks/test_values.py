"""Content checks of point clouds, and of numeric fields of any type."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kleinkram.recordings.recording_files import Openable
from tests.recording_files.memory_source import MemorySource
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros1_bag, ros2_mcap
from tests.recording_files.writers import McapWriter
from tests.unit.checks.content_checks import ERROR, NOT_MADE, OK, only, run, statuses

WRITERS = pytest.mark.parametrize("write", [ros1_bag, ros2_mcap])
Write = Callable[..., Openable]
Points = NDArray[np.float32]


def ring(metres: float, count: int = 200) -> Points:
    angles = np.linspace(0, 2 * np.pi, count)
    return np.stack([metres * np.cos(angles), metres * np.sin(angles), 0 * angles], axis=-1).astype(np.float32)


def clouds(points: Callable[[int], Points]) -> list[TimedMessage]:
    fields = [{"name": axis, "offset": 4 * place, "datatype": 7, "count": 1} for place, axis in enumerate("xyz")]
    messages = []
    for number in range(40):
        xyz = points(number)
        values = {
            "height": 1, "width": len(xyz), "fields": fields, "point_step": 12, "row_step": 12 * len(xyz),
            "data": xyz.tobytes(),
        }  # fmt: skip
        time_ns = T0 + number * SECOND // 10
        messages.append(TimedMessage("/lidar", "sensor_msgs/PointCloud2", time_ns, values, time_ns))
    return messages


CLOUDS = "point_clouds: {'/li*': {min_points: 100, min_range: 0.5, max_range: 100}}"


@WRITERS
def test_good_clouds_pass(write: Write) -> None:
    rows = run(CLOUDS, write(clouds(lambda number: ring(5 + number))))
    assert statuses(rows) == {"cloud.empty": OK, "cloud.range": OK}


@WRITERS
@pytest.mark.parametrize(
    "empty", [ring(5, 0), ring(5, 99), np.zeros((200, 3), np.float32), np.full((200, 3), np.nan, np.float32)]
)
def test_empty_clouds_are_found(empty: Points, write: Write) -> None:
    rows = run(CLOUDS, write(clouds(lambda number: empty if number > 20 else ring(5))))
    row = only(rows, "cloud.empty")
    assert (row.status, row.limit) == (ERROR, 100)
    assert row.time_ns is not None
    assert row.time_ns > T0 + 2 * SECOND


@pytest.mark.parametrize("metres", [0.1, 500])
def test_ranges_that_are_not_plausible_are_found(metres: float) -> None:
    rows = run(CLOUDS, ros2_mcap(clouds(lambda number: ring(metres) if number % 4 == 0 else ring(9))))
    row = only(rows, "cloud.range")
    assert row.status is ERROR
    assert f"{metres:.4g} m" in row.message


def test_a_cloud_without_coordinates_is_not_made() -> None:
    (row,) = run("point_clouds: {/imu: {}}", ros2_mcap([TimedMessage("/imu", "sensor_msgs/Imu", T0, {}, T0)]))
    assert (row.status, row.name) == (NOT_MADE, "cloud.empty")


def joints(position: Callable[[int], list[float]], message_type: str = "sensor_msgs/JointState") -> list[TimedMessage]:
    times = [T0 + number * SECOND // 10 for number in range(50)]
    return [TimedMessage("/joints", message_type, at, {"position": position(n)}, at) for n, at in enumerate(times)]


@WRITERS
def test_nan_is_found_with_the_field_and_the_time(write: Write) -> None:
    assert run("values: {/joints: {}}", write(joints(lambda number: [1.0, number])))[0].status is OK
    (row,) = run("values: {/joints: {}}", write(joints(lambda n: [1.0, math.nan if n == 30 else n])))
    assert (row.status, row.name, row.time_ns) == (ERROR, "value.nan", T0 + 3 * SECOND)
    assert row.message == "NaN or infinite in 1 of 50 messages: position"


def test_some_nan_can_be_allowed() -> None:
    (row,) = run("values: {/joints: {max_nan: 10%}}", ros2_mcap(joints(lambda n: [math.inf if n == 30 else n])))
    assert (row.status, row.value) == (OK, 0.02)


def test_constant_fields_are_found() -> None:
    rules = "values: {/joints: {varies: true, fields: [position]}}"
    assert only(run(rules, ros2_mcap(joints(lambda n: [n]))), "value.constant").status is OK
    row = only(run(rules, ros2_mcap(joints(lambda _n: [0.5, 0.25]))), "value.constant")
    assert (row.status, row.message) == (ERROR, "constant in 50 messages: position")


def test_values_outside_of_the_range_are_found() -> None:
    rules = "values: {/joints: {min: -3, max: 40, fields: ['pos*']}}"
    assert only(run(rules, ros2_mcap(joints(lambda n: [min(n, 40)]))), "value.range").status is OK
    row = only(run(rules, ros2_mcap(joints(lambda n: [n]))), "value.range")
    assert (row.status, row.value, row.limit, row.time_ns) == (ERROR, 49, 40, T0 + 49 * SECOND // 10)
    row = only(run(rules, ros2_mcap(joints(lambda n: [-n]))), "value.range")
    assert (row.status, row.value, row.limit) == (ERROR, -49, -3)


def test_nested_fields_have_dotted_names() -> None:
    rules = "values: {/odom: {fields: [pose.pose.position.x], max: 5}}"
    odometry = [
        TimedMessage("/odom", "nav_msgs/Odometry", T0 + n, {"pose": {"pose": {"position": {"x": n, "y": 99}}}}, T0)
        for n in range(10)
    ]
    row = only(run(rules, ros2_mcap(odometry)), "value.range")
    assert (row.status, row.value) == (ERROR, 9)


def test_a_field_that_does_not_exist_is_not_made() -> None:
    (row,) = run("values: {/joints: {fields: [nothing.*]}}", ros2_mcap(joints(lambda n: [n])))
    assert (row.status, row.message) == (NOT_MADE, "no numeric field matches nothing.*")


def json_mcap(*values: Any) -> MemorySource:
    out = BytesIO()
    writer = McapWriter(out)
    channel = writer.add_channel("/json", writer.add_schema("thing", "jsonschema", b"{}"), "json")
    for number, value in enumerate(values):
        writer.add_message(channel, T0 + number, value if isinstance(value, bytes) else json.dumps(value).encode())
    writer.finish()
    return MemorySource(out.getvalue())


def test_json_is_checked_like_ros() -> None:
    rules = "values: {/json: {max: 5}}"
    rows = run(rules, json_mcap({"a": {"b": [1, 2]}}, {"a": {"b": [3, 9]}, "text": "x", "flag": True}))
    assert only(rows, "value.range").message.startswith("a.b: a.b is 9")


def test_json_of_strangers_breaks_nothing() -> None:
    huge = b'{"a": 1' + b"0" * 4000 + b"}"
    strange = [
        huge,
        b"{",
        {"transforms": 3},
        {"transforms": {"a": 1}},
        {"header": {"stamp": {"sec": 1e300, "nanosec": 0}}},
    ]
    sections = {
        "clocks": "{max_stamp_offset: 1s, max_stamp_drift: 1, max_stamp_jump: 1s}", "images": "{}", "imu": "{}",
        "positions": "{}", "point_clouds": "{}", "transforms": "{}", "odometry": "{}",
        "batteries": "{min_voltage: 1}", "values": "{max: 1}",
    }  # fmt: skip
    rules = "\n".join(f"{name}: {{/json: {rule}}}" for name, rule in sections.items())
    rows = run(rules, json_mcap(*strange))
    assert rows
    assert not [row for row in rows if row.status is OK and not row.name.startswith("value")]
