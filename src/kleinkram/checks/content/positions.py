"""Checks of positions of satellite navigation: fix and jumps.

Source: sensor_msgs/NavSatStatus: a status of -1 is no fix.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from kleinkram.checks.content.probe import Probe, SampledMessage, number
from kleinkram.checks.document import PositionRule
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.decoding.values import part, type_name

_EARTH_RADIUS_M = 6_371_000
_NO_FIX = -1
_SHORTEST_S = 0.02


class PositionProbe(Probe[PositionRule]):
    """Checks of the positions of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._fixes = 0
        self._lost_ns: int | None = None
        self._previous: tuple[int, float, float] | None = None
        self._fastest = 0.0
        self._fastest_ns: int | None = None
        self._steps = 0

    def measure(self, sample: SampledMessage) -> None:
        """Count the fix, and compare the position with the one before."""
        latitude, longitude, has_fix = _position(sample.value)
        if not has_fix:
            self._lost_ns = sample.log_time_ns if self._lost_ns is None else self._lost_ns
            return
        self._fixes += 1
        if self._previous is not None:
            duration_s = max(_SHORTEST_S, abs(sample.time_ns - self._previous[0]) / 1e9)
            speed = distance_m(self._previous[1], self._previous[2], latitude, longitude) / duration_s
            self._steps += 1
            if speed > self._fastest:
                self._fastest, self._fastest_ns = speed, sample.log_time_ns
        self._previous = sample.time_ns, latitude, longitude

    def results(self) -> Iterator[Check]:
        """Yield the checks of fix and jumps."""
        share = self._fixes / self.decoded
        yield self.outcome(
            "position.fix",
            f"{self._fixes} of {self.decoded} positions have a fix",
            fails=share < self.rule.min_fix,
            value=share,
            limit=self.rule.min_fix,
            time_ns=self._lost_ns,
        )
        if not self._steps:
            yield self.row("position.jump", CheckStatus.not_made, "there are no two positions with a fix")
            return
        yield self.outcome(
            "position.jump",
            f"the position changes by at most {number(self._fastest)} m/s",
            fails=self._fastest > self.rule.max_speed,
            value=self._fastest,
            limit=self.rule.max_speed,
            unit="m/s",
            time_ns=self._fastest_ns,
        )


def _position(value: object) -> tuple[float, float, bool]:
    """Return latitude and longitude in degrees, and whether they are a fix. Raises DecodeError."""
    try:
        latitude, longitude = float(part(value, "latitude")), float(part(value, "longitude"))
        status = part(part(value, "status"), "status")
        has_status = status is None or int(status) > _NO_FIX
    except (TypeError, ValueError):
        raise DecodeError(type_name(value), "it has no latitude and longitude") from None
    is_on_earth = abs(latitude) <= 90 and abs(longitude) <= 360 and (latitude, longitude) != (0, 0)
    return latitude, longitude, has_status and is_on_earth


def distance_m(latitude: float, longitude: float, other_latitude: float, other_longitude: float) -> float:
    """Return the distance of two positions in degrees along a great circle. Source: haversine formula."""
    first, second = math.radians(latitude), math.radians(other_latitude)
    across = math.sin(math.radians(other_longitude - longitude) / 2) ** 2
    along = math.sin((second - first) / 2) ** 2 + math.cos(first) * math.cos(second) * across
    return 2 * _EARTH_RADIUS_M * math.asin(math.sqrt(min(1.0, along)))
