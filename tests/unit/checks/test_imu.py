"""Content checks of inertial measurements: gravity, tilt, saturation, constant values."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator

import pytest

from kleinkram.recordings.recording_files import Openable
from tests.recording_files.ros_messages import SECOND, T0, TimedMessage, ros1_bag, ros2_mcap
from tests.unit.checks.content_checks import ERROR, NOT_MADE, OK, only, run, statuses

RULES = "imu: {/imu: {up: z, max_acceleration: 40, max_turn_rate: 8}}"
Vector = tuple[float, float, float]
Motion = Callable[[float, random.Random], tuple[Vector, Vector]]
WRITERS = pytest.mark.parametrize("write", [ros1_bag, ros2_mcap])


def still(gravity: Vector = (0, 0, 9.81)) -> Motion:
    """A sensor at rest, with noise."""

    def measure(_seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        x, y, z = (axis + chance.gauss(0, 0.03) for axis in gravity)
        return (x, y, z), (chance.gauss(0, 0.001), chance.gauss(0, 0.001), chance.gauss(0, 0.001))

    return measure


def walking(gravity: float) -> Motion:
    """A legged robot that trots all the time."""

    def measure(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        step = math.sin(2 * math.pi * 2.5 * seconds)
        acceleration = (chance.gauss(0, 1), chance.gauss(0, 1), gravity + 3 * step + chance.gauss(0, 1))
        return acceleration, (0.5 * step, chance.gauss(0, 0.2), chance.gauss(0, 0.2))

    return measure


def imu(motion: Motion, seconds: float = 4, **fields: object) -> Iterator[TimedMessage]:
    """Yield measurements at 200 Hz."""
    chance = random.Random(1)
    for number in range(int(seconds * 200)):
        acceleration, turn_rate = motion(number / 200, chance)
        values = {
            "linear_acceleration": dict(zip("xyz", acceleration, strict=True)),
            "angular_velocity": dict(zip("xyz", turn_rate, strict=True)),
            **fields,
        }
        time_ns = T0 + number * SECOND // 200
        yield TimedMessage("/imu", "sensor_msgs/Imu", time_ns, values, time_ns)


@WRITERS
def test_a_good_sensor_passes(write: Callable[..., Openable]) -> None:
    rows = run(RULES, write(imu(still())))
    assert statuses(rows) == {
        "imu.gravity": OK,
        "imu.tilt": OK,
        "imu.saturated": OK,
        "imu.constant": OK,
    }
    assert only(rows, "imu.gravity").value == pytest.approx(9.81, abs=0.02)


@WRITERS
def test_a_sensor_that_measures_no_gravity_is_found(write: Callable[..., Openable]) -> None:
    row = only(run(RULES, write(imu(still((0, 0, 1.0))))), "imu.gravity")
    assert (row.status, row.limit, row.unit) == (ERROR, 9.81, "m/s²")
    assert row.value == pytest.approx(1.0, abs=0.02)
    assert "while still" in row.message


def test_tilted_gravity_is_found() -> None:
    tilted = still((9.81 * math.sin(math.radians(30)), 0, 9.81 * math.cos(math.radians(30))))
    rows = run(RULES, ros2_mcap(imu(tilted)))
    tilt = only(rows, "imu.tilt")
    assert tilt.status is ERROR
    assert tilt.value == pytest.approx(30, abs=0.5)
    assert only(rows, "imu.gravity").status is OK


@pytest.mark.parametrize(("up", "gravity"), [("-z", (0, 0, -9.81)), ("x", (9.81, 0, 0)), ("-y", (0, -9.81, 0))])
def test_the_axis_that_points_up_can_be_any(up: str, gravity: Vector) -> None:
    source = ros2_mcap(imu(still(gravity)))
    assert only(run(f"imu: {{/imu: {{up: {up}}}}}", source), "imu.tilt").status is OK
    opposite = up[1:] if up.startswith("-") else f"-{up}"
    assert only(run(f"imu: {{/imu: {{up: {opposite}}}}}", source), "imu.tilt").value == pytest.approx(180, abs=1)


def test_a_robot_that_never_stands_still_is_judged_by_all_measurements() -> None:
    row = only(run(RULES, ros2_mcap(imu(walking(9.81)))), "imu.gravity")
    assert row.status is OK
    assert "never still" in row.message
    assert only(run(RULES, ros2_mcap(imu(walking(5)))), "imu.gravity").status is ERROR


def test_gravity_is_measured_where_the_robot_stands() -> None:
    def standing_then_walking(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        return (still((0, 0, 8.0)) if seconds < 1 else walking(9.81))(seconds, chance)

    row = only(run(RULES, ros2_mcap(imu(standing_then_walking))), "imu.gravity")
    assert row.status is ERROR
    assert row.value == pytest.approx(8.0, abs=0.05)


def test_saturation_is_found_on_either_quantity() -> None:
    def bump(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        acceleration, turn_rate = still()(seconds, chance)
        return ((-40.0, 0, 9.81), turn_rate) if 2 < seconds < 2.02 else (acceleration, turn_rate)

    def spin(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        return still()(seconds, chance)[0], (0, 8.0 if seconds > 3 else chance.gauss(0, 1), 0)

    row = only(run(RULES, ros2_mcap(imu(bump))), "imu.saturated")
    assert (row.status, row.value, row.unit) == (ERROR, 40, "m/s²")
    assert row.time_ns is not None
    assert row.time_ns > T0 + 2 * SECOND
    row = only(run(RULES, ros2_mcap(imu(spin))), "imu.saturated")
    assert (row.status, row.value, row.unit) == (ERROR, 8, "rad/s")


def test_constant_values_are_found() -> None:
    row = only(run(RULES, ros2_mcap(imu(lambda _s, _c: ((0, 0, 9.81), (0, 0, 0))))), "imu.constant")
    assert row.status is ERROR
    assert row.message.startswith("linear_acceleration, angular_velocity never changes")

    def dead_axis(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        (x, _, z), turn_rate = still()(seconds, chance)
        return (x, 0.125, z), turn_rate

    assert "linear_acceleration.y" in only(run(RULES, ros2_mcap(imu(dead_axis))), "imu.constant").message


def test_a_planar_simulation_has_axes_that_are_always_zero() -> None:
    def planar(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        return still()(seconds, chance)[0], (0, 0, chance.gauss(0, 0.01))

    assert only(run(RULES, ros2_mcap(imu(planar))), "imu.constant").status is OK


def test_nan_is_never_green() -> None:
    nan = math.nan
    rows = run(RULES, ros2_mcap(imu(lambda _s, _c: ((nan, nan, nan), (nan, nan, nan)))))
    assert only(rows, "imu.gravity").status is ERROR
    assert only(rows, "imu.tilt").status is ERROR
    assert only(rows, "imu.saturated").status is NOT_MADE
    assert only(rows, "imu.constant").status is NOT_MADE

    def some(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        return still((0, 0, 5.0) if seconds < 2 else (nan, 0, 9.81))(seconds, chance)

    assert only(run(RULES, ros2_mcap(imu(some))), "imu.gravity").value == pytest.approx(5.0, abs=0.02)


def test_measurements_without_value_are_not_counted_as_passed() -> None:
    def broken_gyroscope(until: float) -> Motion:
        def measure(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
            acceleration, turn_rate = still()(seconds, chance)
            return acceleration, (math.nan, *turn_rate[1:]) if seconds < until else turn_rate

        return measure

    rows = run(RULES, ros2_mcap(imu(broken_gyroscope(3))))
    reason = "600 of 800 measurements of the turn rate have no value"
    assert only(rows, "imu.gravity").status is OK
    for name in ("imu.saturated", "imu.constant"):
        assert (only(rows, name).status, only(rows, name).message) == (NOT_MADE, reason)
    rows = run(RULES, ros2_mcap(imu(broken_gyroscope(1))))
    assert only(rows, "imu.constant").status is OK
    assert only(rows, "imu.constant").message == "all axes change (600 measurements)"


def test_constant_values_beside_nan_are_found() -> None:
    def stuck(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        return still()(seconds, chance)[0], ((0.1, 0.2, 0.3) if seconds < 1 else (math.nan, 0.2, 0.3))

    row = only(run(RULES, ros2_mcap(imu(stuck))), "imu.constant")
    assert (row.status, row.message) == (ERROR, "angular_velocity never changes (200 measurements)")


def test_gravity_that_is_mostly_nan_is_not_made() -> None:
    def rare(seconds: float, chance: random.Random) -> tuple[Vector, Vector]:
        return (still()(seconds, chance)[0] if seconds < 1 else (math.nan, 0, 9.81)), (0, 0, chance.gauss(0, 0.01))

    rows = statuses(run(RULES, ros2_mcap(imu(rare))))
    assert (rows["imu.gravity"], rows["imu.tilt"]) == (NOT_MADE, NOT_MADE)


def test_a_range_of_what_the_sensor_does_not_measure_is_not_made() -> None:
    still_accelerometer = imu(still(), angular_velocity_covariance=[-1.0] + [0] * 8)
    rows = run(RULES, ros2_mcap(still_accelerometer))
    reason = "it says, by its covariance, that it does not measure the turn rate"
    assert (only(rows, "imu.saturated").status, only(rows, "imu.saturated").message) == (NOT_MADE, reason)
    row = only(rows, "imu.constant")
    assert (row.status, row.message) == (OK, "all axes of the acceleration change (800 measurements)")
    no = [-1.0] + [0] * 8
    nothing = imu(still(), linear_acceleration_covariance=no, angular_velocity_covariance=no)
    assert only(run(RULES, ros2_mcap(nothing)), "imu.constant").status is NOT_MADE


def test_a_gyroscope_without_accelerometer_is_not_judged_by_gravity() -> None:
    source = ros2_mcap(imu(lambda s, c: ((0, 0, 0), still()(s, c)[1]), linear_acceleration_covariance=[-1.0] + [0] * 8))
    rows = statuses(run(RULES, source))
    assert rows["imu.gravity"] is NOT_MADE
    assert rows["imu.constant"] is OK


def test_another_type_that_the_rule_names_is_not_made() -> None:
    battery = ros2_mcap([TimedMessage("/imu", "sensor_msgs/BatteryState", T0, {}, T0)])
    (row, *_) = run(RULES, battery)
    assert row.status is NOT_MADE
    assert "it has no vector linear_acceleration" in row.message
