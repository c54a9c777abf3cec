"""Motions of the sample robots: where each is at a time, and what an inertial sensor measures of it.

Both move in circles that never end, so that a drive of any length is possible. Frame odom: x east, y north, z up.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

_DRIVE_RADIUS_M, _DRIVE_SPEED_M_S = 25.0, 2.0
_WALK_RADIUS_M, _WALK_SPEED_M_S = 15.0, 1.0
_STANDING_S = 2.0
_START_S = 1.0
_SHAKING = 0.8
_STEP_HZ, _STEP_HEIGHT_M = 2.0, 0.004


class MotionState(NamedTuple):
    """A pose in frame odom, with velocities and accelerations along the axes of the robot: x forward, y left, z up.

    `shaking_m_s2`: standard deviation of what its steps add to the accelerations.
    """

    east_m: float
    north_m: float
    up_m: float
    yaw_rad: float
    speed_m_s: float
    turn_rad_s: float
    forward_m_s2: float
    left_m_s2: float
    up_m_s2: float
    shaking_m_s2: float = 0.0

    @property
    def orientation(self) -> tuple[float, float, float, float]:
        """The quaternion (x, y, z, w) of the heading."""
        return 0.0, 0.0, math.sin(self.yaw_rad / 2), math.cos(self.yaw_rad / 2)


class Mount(NamedTuple):
    """Where a sensor is on the robot: metres along its axes, and the angle from forward to the left."""

    forward_m: float
    left_m: float
    up_m: float
    yaw_rad: float = 0.0

    def pose(self, state: MotionState) -> MotionState:
        """Return the state with the pose of the sensor in place of the robot's."""
        cosine, sine = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
        return state._replace(
            east_m=state.east_m + cosine * self.forward_m - sine * self.left_m,
            north_m=state.north_m + sine * self.forward_m + cosine * self.left_m,
            up_m=state.up_m + self.up_m,
            yaw_rad=state.yaw_rad + self.yaw_rad,
        )


Motion = Callable[[float], MotionState]
"""Returns the state at a time, in seconds since the start of the drive."""


def drive(seconds: float) -> MotionState:
    """Return the state of a vehicle that drives in a circle at constant speed."""
    return _on_circle(_DRIVE_RADIUS_M, _DRIVE_SPEED_M_S * seconds, _DRIVE_SPEED_M_S, 0.0)


def walk(seconds: float) -> MotionState:
    """Return the state of a legged robot that stands still for two seconds and then walks in a circle."""
    walking_s = seconds - _STANDING_S
    if walking_s <= 0:
        return _on_circle(_WALK_RADIUS_M, 0.0, 0.0, 0.0)
    if walking_s < _START_S:
        phase = math.pi * walking_s / _START_S
        speed = _WALK_SPEED_M_S * (1 - math.cos(phase)) / 2
        distance = _WALK_SPEED_M_S * (walking_s - math.sin(phase) * _START_S / math.pi) / 2
        acceleration = _WALK_SPEED_M_S * math.sin(phase) * math.pi / _START_S / 2
    else:
        speed, acceleration = _WALK_SPEED_M_S, 0.0
        distance = _WALK_SPEED_M_S * (walking_s - _START_S / 2)
    step = 2 * math.pi * _STEP_HZ
    state = _on_circle(_WALK_RADIUS_M, distance, speed, acceleration)
    return state._replace(
        up_m=_STEP_HEIGHT_M * (1 - math.cos(step * walking_s)) / 2,
        up_m_s2=_STEP_HEIGHT_M * step**2 * math.cos(step * walking_s) / 2,
        shaking_m_s2=_SHAKING * speed,
    )


def _on_circle(radius_m: float, distance_m: float, speed_m_s: float, forward_m_s2: float) -> MotionState:
    angle, turn_rad_s = distance_m / radius_m, speed_m_s / radius_m
    east, north = radius_m * math.cos(angle), radius_m * math.sin(angle)
    yaw = math.remainder(angle + math.pi / 2, 2 * math.pi)
    return MotionState(
        east, north, 0.0, yaw, speed_m_s, turn_rad_s, forward_m_s2, speed_m_s * turn_rad_s, 0.0
    )  # fmt: skip
