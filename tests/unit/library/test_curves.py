"""Numbers of topics over time, and tracks."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable

import numpy as np
import pytest

from kleinkram.library.curves import (
    BINS,
    MAX_ELEMENTS,
    Curve,
    TimeSpan,
    TopicNumbers,
    Track,
    east_north,
    most_interesting,
    numeric_fields,
    panels_of,
)
from kleinkram.library.pictures import plot_range
from kleinkram.library.preview import Collected, Options, geojson, read_numbers
from kleinkram.recordings import Channel, RawMessage, Recording, Schema
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros2_mcap

SPAN = TimeSpan(T0, T0 + 10 * SECOND)


def numbers_of(messages: Iterable[TimedMessage], span: TimeSpan = SPAN) -> TopicNumbers:
    timed = list(messages)
    with Recording.open(ros2_mcap(timed)) as recording:
        (topic,) = recording.topics
        numbers = TopicNumbers(topic.name, topic.message_type, span)
        for message in recording.raw_messages():
            numbers.add(message)
        numbers.finish()
    return numbers


def imu(second: float, x: float) -> TimedMessage:
    values = {"linear_acceleration": {"x": x, "z": 9.81}, "angular_velocity": {"y": -x}}
    return TimedMessage("/imu", "sensor_msgs/Imu", T0 + round(second * SECOND), values, T0)


def test_a_spike_of_one_message_stays_visible() -> None:
    numbers = numbers_of(imu(number / 1000, 150.0 if number == 4321 else 0.5) for number in range(10_001))
    curve = numbers.curves["linear_acceleration.x"]
    assert curve.count == 10_001
    assert curve.bounds == (0.5, 150.0)
    spike = int(4.321 / 10 * BINS)
    assert np.flatnonzero(curve.high > 1).tolist() == [spike]
    assert curve.low[spike] == 0.5
    assert not np.isnan(curve.low).any()


def test_the_axes_of_a_vector_are_one_plot_with_its_unit() -> None:
    numbers = numbers_of(imu(number / 10, math.sin(number)) for number in range(50))
    panels = {panel.field: panel for panel in panels_of(numbers)}
    assert {name: panel.unit for name, panel in panels.items()} == {
        "linear_acceleration": "m/s²",
        "angular_velocity": "rad/s",
    }
    assert [name for name, _ in panels["angular_velocity"].curves] == ["x", "y", "z"]


def test_elements_of_arrays_are_curves_by_the_names_of_the_joints() -> None:
    names = [f"joint{number}" for number in range(MAX_ELEMENTS + 3)]
    messages = [
        TimedMessage(
            "/joints",
            "sensor_msgs/JointState",
            T0 + number * SECOND,
            {"name": names, "position": [number + 0.1 * joint for joint in range(len(names))], "velocity": []},
            T0,
        )
        for number in range(5)
    ]
    (panel,) = panels_of(numbers_of(messages))
    assert (panel.field, panel.unit) == ("position", "rad")
    assert [name for name, _ in panel.curves] == names[:MAX_ELEMENTS]
    assert panel.curves[3][1].bounds == pytest.approx((0.3, 4.3))


def test_values_that_are_not_finite_are_counted_and_left_out() -> None:
    values = [1.0, math.nan, math.inf, -math.inf, 2.0]
    numbers = numbers_of(
        TimedMessage("/value", "std_msgs/Float64", T0 + number * SECOND, {"data": value})
        for number, value in enumerate(values)
    )
    (panel,) = panels_of(numbers)
    assert panel.curves[0][1].bounds == (1.0, 2.0)
    assert panel.curves[0][1].not_finite == 3


def test_the_axis_of_a_plot_has_all_values_and_a_margin() -> None:
    numbers = numbers_of(imu(number, float(number)) for number in range(10))
    acceleration, turn_rate = panels_of(numbers)
    assert plot_range(acceleration) == pytest.approx((-0.05 * 9.81, 1.05 * 9.81))
    assert plot_range(turn_rate) == pytest.approx((-9.45, 0.45))
    (still,) = panels_of(numbers_of([TimedMessage("/still", "std_msgs/Float64", T0, {"data": 3.0})]))
    assert plot_range(still) == pytest.approx((2.85, 3.15))


def test_a_topic_of_nan_only_has_no_plot() -> None:
    numbers = numbers_of([TimedMessage("/value", "std_msgs/Float64", T0, {"data": math.nan})])
    assert panels_of(numbers) == []


def test_all_times_at_zero_are_one_moment() -> None:
    messages = [TimedMessage("/value", "std_msgs/Float64", 0, {"data": float(number)}) for number in range(20)]
    curve = numbers_of(messages, TimeSpan(0, 0)).curves["data"]
    assert curve.bounds == (0, 19)
    assert np.flatnonzero(~np.isnan(curve.low)).tolist() == [0]


def test_messages_outside_of_the_time_of_the_mission_are_left_out() -> None:
    numbers = numbers_of([imu(-5, 7.0), imu(5, 1.0), imu(50, 8.0)])
    assert numbers.curves["linear_acceleration.x"].bounds == (1.0, 1.0)


def test_of_a_large_mission_segments_are_read_that_are_spread_evenly() -> None:
    collected = Collected(Options(("*",), (), frames=12, max_plots=24), SPAN, camera_count=0)
    collected.share = 0.1
    messages = [imu(number / 1000, 0.5) for number in range(10_001)]
    with Recording.open(ros2_mcap(messages, chunk_bytes=2**14)) as recording:
        collected.plan(recording.topics)
        read_numbers(recording, collected)
    numbers = collected.numbers["/imu"]
    numbers.finish()
    curve = numbers.curves["linear_acceleration.x"]
    assert 0.05 < curve.count / len(messages) < 0.12
    used = np.flatnonzero(~np.isnan(curve.low))
    assert (used[0], used[-1]) == (0, BINS - 1)
    assert np.diff(used).max() < 0.15 * BINS


def test_numbers_in_json_are_found_in_the_messages() -> None:
    channel = Channel("/json", "json", Schema("Status", "jsonschema", b"{}"))
    numbers = TopicNumbers("/json", "Status", SPAN)
    for number in range(20):
        data = json.dumps({"motor": {"rpm": number * 10, "on": True}, "name": "left"}).encode()
        numbers.add(RawMessage("/json", T0 + number, T0, 0, data, channel))
    numbers.add(RawMessage("/json", T0, T0, 0, b"{", channel))
    numbers.finish()
    assert {name: curve.bounds for name, curve in numbers.curves.items()} == {"motor.rpm": (0, 190), "motor.on": (1, 1)}
    assert numbers.failed == 1


def test_fields_without_numbers_are_known_before_messages_are_read() -> None:
    for message_type, fields in (("std_msgs/String", []), ("sensor_msgs/Temperature", ["temperature", "variance"])):
        with Recording.open(ros2_mcap([TimedMessage("/t", message_type, T0, {})])) as recording:
            assert numeric_fields(recording.topics[0]) == fields


@pytest.mark.parametrize(
    ("message_type", "unit"),
    [("sensor_msgs/msg/Temperature", "°C"), ("foxglove.Temperature", "°C"), ("lab/Temperature", "")],
)
def test_fields_of_other_packages_have_no_units(message_type: str, unit: str) -> None:
    numbers = TopicNumbers("/json", message_type, SPAN)
    channel = Channel("/json", "json", Schema(message_type, "jsonschema", b"{}"))
    for number in range(3):
        numbers.add(RawMessage("/json", T0 + number, T0, 0, json.dumps({"temperature": number}).encode(), channel))
    numbers.finish()
    assert [(panel.field, panel.unit) for panel in panels_of(numbers)] == [("temperature", unit)]


def test_counters_and_times_are_not_plotted() -> None:
    channel = Channel("/json", "json", Schema("Status", "jsonschema", b"{}"))
    numbers = TopicNumbers("/json", "Status", SPAN)
    for number in range(3):
        data = json.dumps({"header": {"seq": number}, "timestamp_sample": number, "covariance": [1.0], "rpm": number})
        numbers.add(RawMessage("/json", T0 + number, T0, 0, data.encode(), channel))
    numbers.finish()
    assert list(numbers.curves) == ["rpm"]


def test_a_planar_pose_has_a_track() -> None:
    values = [{"x": float(number), "y": 2.0, "theta": 0.1} for number in range(4)]
    numbers = numbers_of(
        TimedMessage("/pose", "geometry_msgs/Pose2D", T0 + number * SECOND, pose) for number, pose in enumerate(values)
    )
    assert numbers.track is not None
    assert numbers.track.rows[:, 1:].tolist() == [[0, 2], [1, 2], [2, 2], [3, 2]]


def test_every_topic_has_a_plot_before_one_has_two_and_constants_come_last() -> None:
    moving = numbers_of(imu(number, float(number)) for number in range(10))
    still = numbers_of(TimedMessage("/still", "std_msgs/Float64", T0 + number, {"data": 3.0}) for number in range(10))
    other = numbers_of(
        TimedMessage("/other", "std_msgs/Float64", T0 + number * SECOND, {"data": float(number)}) for number in range(9)
    )
    panels = [panel for numbers in (still, other, moving) for panel in panels_of(numbers)]
    chosen = [(panel.topic, panel.field) for panel in most_interesting(panels, 3)]
    assert chosen == [("/imu", "linear_acceleration"), ("/imu", "angular_velocity"), ("/other", "data")]
    assert [panel.topic for panel in most_interesting(panels, 2)] == ["/imu", "/other"]


def test_a_long_track_is_thinned_evenly() -> None:
    track = Track(is_gnss=False)
    for begin in range(0, 200_000, 7_000):
        part = np.arange(begin, min(begin + 7_000, 200_000), dtype=np.float64)
        track.add(part, np.column_stack([part, -part]), np.ones(len(part), bool))
    steps = np.diff(track.rows[:, 0])
    assert track.count == 200_000
    assert 10_000 <= len(track.rows) <= 20_000
    assert steps.max() <= 2 * np.median(steps)
    assert (track.rows[0, 0], track.rows[-1, 0]) == pytest.approx((0, 200_000), abs=50)


def test_metres_of_gnss_are_right_to_half_a_percent() -> None:
    """Zurich: one degree of latitude has 111.2 km, one of longitude 75.5 km."""
    metres = east_north(np.array([[8.54, 47.37], [8.55, 47.37], [8.54, 47.38]]), (8.54, 47.37))
    assert metres[0] == pytest.approx((0, 0))
    assert metres[1] == pytest.approx((755, 0), rel=0.005)
    assert metres[2] == pytest.approx((0, 1112), rel=0.005)
    across = east_north(np.array([[-179.999, 0.0]]), (179.999, 0.0))
    assert across[0] == pytest.approx((222.4, 0), rel=0.005)


def fix(second: float, latitude: float, longitude: float, status: int = 0) -> TimedMessage:
    values = {"status": {"status": status}, "latitude": latitude, "longitude": longitude, "altitude": 400.0}
    return TimedMessage("/fix", "sensor_msgs/NavSatFix", T0 + round(second * SECOND), values, T0)


def test_positions_without_fix_are_not_part_of_the_track() -> None:
    good = [fix(number, 47.0 + number / 1e5, 8.0) for number in range(5)]
    bad = [fix(5, 47.1, 8.0, -1), fix(6, 0.0, 0.0), fix(7, math.nan, 8.0), fix(8, 147.0, 8.0)]
    numbers = numbers_of([*good, *bad])
    assert numbers.track is not None
    assert (numbers.track.count, numbers.track.unusable) == (5, 4)
    collection = geojson({"/fix": numbers})
    assert collection == {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"topic": "/fix", "positions": 5},
                "geometry": {
                    "type": "LineString",
                    "coordinates": [[8.0, round(47.0 + number / 1e5, 7)] for number in range(5)],
                },
            }
        ],
    }


def test_one_position_is_a_point() -> None:
    features = geojson({"/fix": numbers_of([fix(0, 47.0, 8.0)])})["features"]
    assert isinstance(features, list)
    assert features[0]["geometry"] == {"type": "Point", "coordinates": [8.0, 47.0]}


def test_a_curve_without_values_has_none() -> None:
    curve = Curve()
    curve.add(np.array([-1, 3]), np.array([1.0, math.nan]))
    assert (curve.count, curve.not_finite) == (0, 1)
