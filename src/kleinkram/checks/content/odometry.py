"""Checks of odometry and poses: jumps of position and orientation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from kleinkram.checks.content.probe import Probe, SampledMessage, number
from kleinkram.checks.document import OdometryRule
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.decoding.values import part, type_name

_SHORTEST_S = 0.01


class Pose(NamedTuple):
    """A position in metres and a unit quaternion (x, y, z, w); without orientation, None."""

    time_ns: int
    position: tuple[float, ...]
    orientation: tuple[float, ...] | None


class OdometryProbe(Probe[OdometryRule]):
    """Checks of the poses of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._previous: Pose | None = None
        self._steps = self._unusable = 0
        self._worst = {"m/s": (0.0, 0), "rad/s": (0.0, 0)}

    def measure(self, sample: SampledMessage) -> None:
        """Compare the pose with the one before."""
        pose = _pose(sample.value, sample.time_ns)
        if not all(map(math.isfinite, (*pose.position, *(pose.orientation or ())))):
            self._unusable += 1
            return
        previous, self._previous = self._previous, pose
        if previous is None:
            return
        self._steps += 1
        duration_s = max(_SHORTEST_S, abs(pose.time_ns - previous.time_ns) / 1e9)  # log times may jump back
        self._note("m/s", math.dist(pose.position, previous.position) / duration_s, sample.log_time_ns)
        if pose.orientation is not None and previous.orientation is not None:
            angle = _angle_between(pose.orientation, previous.orientation)
            self._note("rad/s", angle / duration_s, sample.log_time_ns)

    def results(self) -> Iterator[Check]:
        """Yield the check of jumps: of what exceeds its limit most."""
        if not self._steps:
            reason = "all poses are NaN or infinite" if self._unusable else "there is only one pose"
            yield self.row("odometry.jump", CheckStatus.not_made, reason)
            return
        limits = {"m/s": self.rule.max_speed, "rad/s": self.rule.max_turn_rate}
        unit = max(limits, key=lambda name: self._worst[name][0] / limits[name])
        value, time_ns = self._worst[unit]
        what = "position" if unit == "m/s" else "orientation"
        fails = value > limits[unit]
        if not fails and 2 * self._unusable > self.decoded:
            reason = f"{self._unusable} of {self.decoded} poses have no value"
            yield self.row("odometry.jump", CheckStatus.not_made, reason)
            return
        ignored = f" ({self._unusable} poses are NaN or infinite)" if self._unusable else ""
        yield self.outcome(
            "odometry.jump",
            f"the {what} changes by at most {number(value)} {unit}{ignored}",
            fails=fails,
            value=value,
            limit=limits[unit],
            unit=unit,
            time_ns=time_ns,
        )

    def _note(self, unit: str, value: float, time_ns: int) -> None:
        if value > self._worst[unit][0]:
            self._worst[unit] = value, time_ns


def _pose(value: object, time_ns: int) -> Pose:
    """Return the pose of nav_msgs/Odometry, geometry_msgs/Pose* and TransformStamped. Raises DecodeError."""
    pose = part(value, "pose")
    inner = part(pose, "pose")
    pose = inner if inner is not None else pose
    position, orientation = part(pose, "position"), part(pose, "orientation")
    if position is None:
        transform = part(value, "transform")
        position, orientation = part(transform, "translation"), part(transform, "rotation")
    try:
        xyz = tuple(float(part(position, axis)) for axis in "xyz")
        quaternion = None if orientation is None else tuple(float(part(orientation, axis)) for axis in "xyzw")
    except (TypeError, ValueError):
        raise DecodeError(type_name(value), "it has no pose") from None
    size = 0.0 if quaternion is None else math.hypot(*quaternion)
    return Pose(time_ns, xyz, tuple(axis / size for axis in quaternion) if quaternion and size else None)


def _angle_between(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    cosine = abs(sum(a * b for a, b in zip(one, other, strict=True)))
    return 2 * math.acos(min(1.0, cosine))
