"""Checks of inertial measurements: gravity, tilt, saturation, constant values.

Measurements are grouped into short intervals. The sensor is still in an interval with little change of acceleration
and little rotation; gravity is measured there. A sensor that is never still is judged by all measurements, leniently:
by the median magnitude or by the magnitude of the mean vector, whichever is nearer to gravity.

Measurements with NaN or infinity are left out. A check that would pass is not made if they are more than half.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kleinkram.checks.content.probe import Probe, SampledMessage, number
from kleinkram.checks.document import ImuRule
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.decoding.values import part, type_name

_INTERVAL_NS, _GAP_NS = 500_000_000, 250_000_000
_STILL_ACCELERATION, _STILL_TURN_RATE = 0.5, 0.1  # m/s², standard deviation; rad/s, mean
_MAX_MEASUREMENTS = 200_000
_NEAR_LIMIT = 0.999
_AXES = ("x", "y", "z")
_UNITS = {"acceleration": "m/s²", "turn rate": "rad/s"}
Vector = tuple[float, float, float]


class ImuProbe(Probe[ImuRule]):
    """Checks of the inertial measurements of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._times: list[int] = []
        self._acceleration: list[Vector] = []
        self._turn_rate: list[Vector] = []
        self._has_acceleration = self._has_turn_rate = True
        self._quantities: Mapping[str, _Quantity] = {}

    def measure(self, sample: SampledMessage) -> None:
        """Keep the measurement."""
        acceleration = vector(sample.value, "linear_acceleration")
        turn_rate = vector(sample.value, "angular_velocity")
        if len(self._times) >= _MAX_MEASUREMENTS:
            return
        self._has_acceleration = self._has_acceleration and _is_measured(sample.value, "linear_acceleration")
        self._has_turn_rate = self._has_turn_rate and _is_measured(sample.value, "angular_velocity")
        self._times.append(sample.log_time_ns)
        self._acceleration.append(acceleration)
        self._turn_rate.append(turn_rate)

    def results(self) -> Iterator[Check]:
        """Yield the checks of gravity, tilt, saturation and constant values."""
        acceleration, turn_rate = np.array(self._acceleration), np.array(self._turn_rate)
        finite = np.isfinite(acceleration).all(axis=1)
        self._quantities = {
            "acceleration": _Quantity("linear_acceleration", acceleration, finite, self._has_acceleration),
            "turn rate": _Quantity(
                "angular_velocity", turn_rate, np.isfinite(turn_rate).all(axis=1), self._has_turn_rate
            ),
        }
        if not self._has_acceleration or not finite.any():
            reason = "all accelerations are NaN or infinite"
            if not self._has_acceleration:
                reason = "it says, by its covariance, that it does not measure acceleration"
            for name in ("imu.gravity", "imu.tilt"):
                if name in self.names and self._has_acceleration:
                    yield self.outcome(name, reason, fails=True)
                elif name in self.names:
                    yield self.row(name, CheckStatus.not_made, reason)
        else:
            times = [time_ns for time_ns, is_finite in zip(self._times, finite, strict=True) if is_finite]
            yield from self._gravity(times, acceleration[finite], turn_rate[finite])
        if "imu.saturated" in self.names:
            yield self._saturated()
        yield self._constant()

    def _gravity(
        self, times: Sequence[int], acceleration: NDArray[np.float64], turn_rate: NDArray[np.float64]
    ) -> Iterator[Check]:
        still = [
            acceleration[start:end].mean(axis=0)
            for start, end in intervals(times)
            if _is_still(acceleration[start:end], turn_rate[start:end] if self._has_turn_rate else None)
        ]
        gravity = self.rule.gravity
        if still:
            up = np.median(np.array(still), axis=0)
            magnitude, when = float(np.linalg.norm(up)), "while still"
        else:
            up = acceleration.mean(axis=0)
            choices = float(np.median(np.linalg.norm(acceleration, axis=1))), float(np.linalg.norm(up))
            magnitude = min(choices, key=lambda choice: abs(choice - gravity))
            when = "over all samples, since it is never still"
        deviation = abs(magnitude - gravity)
        yield self._unless_missing(
            ["acceleration"],
            "imu.gravity",
            f"it measures {number(magnitude)} m/s² {when}; gravity is {number(gravity)} m/s²",
            fails=deviation > self.rule.gravity_tolerance,
            value=magnitude,
            limit=gravity,
            unit="m/s²",
            time_ns=times[0],
        )
        if self.rule.up is not None:
            yield self._tilt(up, self.rule.up, when, times[0])

    def _tilt(self, up: NDArray[np.float64], axis: str, when: str, time_ns: int) -> Check:
        size = float(np.linalg.norm(up))
        if size == 0:
            return self.outcome("imu.tilt", "it measures no acceleration, so no direction", fails=True, time_ns=time_ns)
        sign = -1 if axis.startswith("-") else 1
        cosine = sign * float(up[_AXES.index(axis[-1])]) / size
        degrees = math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
        return self._unless_missing(
            ["acceleration"],
            "imu.tilt",
            f"its axis {axis} is {number(degrees)}° from up {when}",
            fails=degrees > self.rule.max_tilt,
            value=degrees,
            limit=self.rule.max_tilt,
            unit="°",
            time_ns=time_ns,
        )

    def _unless_missing(
        self, quantities: Sequence[str], name: str, message: str, *, fails: bool, **measured: Any
    ) -> Check:
        """Return the outcome of a check; not made if it would pass and most measurements of a quantity are missing."""
        reasons = [reason for one in quantities if (reason := self._why_missing(one)) is not None]
        if reasons and not fails:
            return self.row(name, CheckStatus.not_made, "; ".join(reasons))
        return self.outcome(name, message, fails=fails, **measured)

    def _why_missing(self, name: str) -> str | None:
        """Return why a quantity is not known well enough."""
        quantity = self._quantities[name]
        if not quantity.is_measured:
            return f"it says, by its covariance, that it does not measure the {name}"
        total = len(quantity.finite)
        missing = total - quantity.known
        if 2 * missing > total or (missing and quantity.known < 2):
            return f"{missing} of {total} measurements of the {name} have no value"
        return None

    def _saturated(self) -> Check:
        """Judge the quantity that uses most of its range."""
        limits = {"acceleration": self.rule.max_acceleration, "turn rate": self.rule.max_turn_rate}
        worst = ("acceleration", 0.0, 1.0, 0, 0)
        for name, limit in limits.items():
            values = self._quantities[name].values
            finite = np.where(np.isfinite(values), np.abs(values), 0)
            if limit is not None and finite.max() / limit >= worst[1] / worst[2]:
                at_limit = int((finite.max(axis=1) >= _NEAR_LIMIT * limit).sum())
                worst = name, float(finite.max()), limit, at_limit, self._times[int(finite.max(axis=1).argmax())]
        quantity, value, limit, count, time_ns = worst
        return self._unless_missing(
            [name for name, bound in limits.items() if bound is not None],
            "imu.saturated",
            f"{count} of {self._quantities[quantity].known} measurements reach the range of the {quantity}",
            fails=count > 0,
            value=value,
            limit=limit,
            unit=_UNITS[quantity],
            time_ns=time_ns,
        )

    def _constant(self) -> Check:
        """Judge the quantities that the sensor measures."""
        if len(self._times) < 2:
            return self.row("imu.constant", CheckStatus.not_made, "there is only one measurement")
        measured = {name: one for name, one in self._quantities.items() if one.is_measured}
        constant = [axis for one in measured.values() for axis in one.constant_axes()]
        message = f"{', '.join(constant)} never changes" if constant else "all axes change"
        if not constant and len(measured) < len(self._quantities):
            message = f"all axes of the {''.join(measured)} change"
        return self._unless_missing(
            [*measured] or [*self._quantities],
            "imu.constant",
            f"{message} ({min((one.known for one in measured.values()), default=0)} measurements)",
            fails=bool(constant),
        )


class _Quantity(NamedTuple):
    """The measurements [N, 3] of one quantity, by the name of its field.

    `finite`: which have a value on all axes. `is_measured`: False if the sensor says that it does not measure it.
    """

    field: str
    values: NDArray[np.float64]
    finite: NDArray[np.bool_]
    is_measured: bool

    @property
    def known(self) -> int:
        """How many have a value."""
        return int(self.finite.sum())

    def constant_axes(self) -> list[str]:
        """Return the axes that never change, or the field if none does.

        An axis that is always 0 is one that a planar simulation does not have, unless all three are.
        """
        values = self.values[self.finite]
        if len(values) < 2:
            return []
        same = (values == values[0]).all(axis=0)
        if same.all():
            return [self.field]
        stuck = zip(_AXES, same, values[0], strict=True)
        return [f"{self.field}.{axis}" for axis, is_same, first in stuck if is_same and first]


def vector(value: object, name: str) -> Vector:
    """Return a vector of a message. Raises DecodeError."""
    field = part(value, name)
    try:
        return float(part(field, "x")), float(part(field, "y")), float(part(field, "z"))
    except (TypeError, ValueError):
        raise DecodeError(type_name(value), f"it has no vector {name}") from None


def intervals(times: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield ranges of measurements, each of half a second at most and without gaps."""
    start = 0
    for place, time_ns in enumerate(times):
        is_apart = place and time_ns - times[place - 1] > _GAP_NS
        if place > start and (is_apart or time_ns - times[start] >= _INTERVAL_NS):
            yield start, place
            start = place
    if start < len(times):
        yield start, len(times)


def _is_still(acceleration: NDArray[np.float64], turn_rate: NDArray[np.float64] | None) -> bool:
    if len(acceleration) < 2 and turn_rate is None:
        return False
    spread = float(np.linalg.norm(acceleration.std(axis=0)))
    turning = 0.0 if turn_rate is None else float(np.linalg.norm(turn_rate.mean(axis=0)))
    return spread < _STILL_ACCELERATION and turning < _STILL_TURN_RATE


def _is_measured(value: object, quantity: str) -> bool:
    """Return whether the sensor measures a quantity. Source: sensor_msgs/Imu: -1 as first element of a covariance."""
    covariance = part(value, f"{quantity}_covariance")
    try:
        return covariance is None or len(covariance) == 0 or float(covariance[0]) != -1
    except (TypeError, ValueError):
        return True
