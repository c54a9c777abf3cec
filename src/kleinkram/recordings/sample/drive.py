"""One drive of a sample robot, as its computers record it: when each message arrives, and by which clock it is logged.

The same seed gives the same messages, whichever computer records them. Memory does not grow with the duration.
"""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Iterator
from typing import NamedTuple

from kleinkram.recordings.sample.defects import Defect, Faults
from kleinkram.recordings.sample.messages import Encoding
from kleinkram.recordings.sample.robots import Robot, Sensor
from kleinkram.recordings.sample.sensors import START_NS, Maker, SensorContext

_JITTER = 0.02
_SECOND_NS = 1_000_000_000
_ONSET = 0.3
_GAP = 0.4, 0.6
_LATE, _EARLY = 0.4, 0.6
_CLOCK_JUMP_NS, _RECORDER_OFFSET_NS = -15 * _SECOND_NS, _SECOND_NS // 4
_STAMP_OFFSET_NS, _STAMP_JUMP_NS, _STAMP_DRIFT = -_SECOND_NS // 2, -_SECOND_NS, 0.02


class RecordedMessage(NamedTuple):
    """One recorded message."""

    log_time_ns: int
    topic: str
    payload: bytes


class Drive:
    """One drive. `expected_s`: about how long it will be; defects begin after a part of that."""

    def __init__(self, robot: Robot, *, seed: int, encoding: Encoding, faults: Faults, expected_s: float) -> None:
        robot.check_defects(faults.defects)
        self._robot = robot.with_defects(faults.defects)
        self._seed, self._encoding, self._faults, self._expected_s = seed, encoding, faults, expected_s

    def sensors(self, computer: str) -> tuple[Sensor, ...]:
        """Return what a computer records."""
        if self._has(Defect.empty_recording, computer):
            return ()
        return tuple(
            sensor
            for sensor in self._robot.sensors
            if computer in sensor.computers and sensor.topic != self._faults.dropped_topic
        )

    def messages(self, computer: str, duration_s: float | None) -> Iterator[RecordedMessage]:
        """Yield what a computer records, in the order of arrival; without end if `duration_s` is None."""
        sensors = self.sensors(computer)
        makers = [self._maker(sensor) for sensor in sensors]
        ticks = heapq.merge(*(self._ticks(number, sensor, computer) for number, sensor in enumerate(sensors)))
        for arrival_ns, order, k, true_ns in ticks:
            seconds = true_ns / _SECOND_NS
            if duration_s is not None and seconds >= duration_s:
                return
            sensor = sensors[order]
            stamp_ns = (
                true_ns + self._clock_error_ns(sensor.computers[0], true_ns) + self._stamp_error_ns(sensor, true_ns)
            )
            log_time_ns = arrival_ns + self._clock_error_ns(computer, arrival_ns)
            payload = makers[order](k, seconds, START_NS + stamp_ns)
            yield RecordedMessage(START_NS + log_time_ns, sensor.topic, payload)

    def _maker(self, sensor: Sensor) -> Maker:
        defects = frozenset(defect for defect in self._faults.defects if self._has(defect, sensor.topic))
        onset_s = _ONSET * self._expected_s
        return sensor.factory(
            SensorContext(sensor.topic, self._seed, self._encoding, self._robot.motion, defects, onset_s)
        )

    def _ticks(self, order: int, sensor: Sensor, computer: str) -> Iterator[tuple[int, int, int, int]]:
        """Yield (arrival, order, number, true time) of one topic, in nanoseconds since the start."""
        if sensor.rate_hz == 0:
            yield sensor.latency_ns, order, 0, 0
            return
        chance = random.Random(f"{self._seed} {sensor.topic} ticks")  # noqa: S311 - repeatable samples, not secrets
        period_ns = _SECOND_NS / sensor.rate_hz
        silences = self._silences_s(sensor, computer)
        ends_early = self._has(Defect.silent_end, sensor.topic) or self._has(Defect.early_end, computer)
        end_s = _EARLY * self._expected_s if ends_early else math.inf
        k = 0
        while True:
            true_ns = round((k + chance.random() * _JITTER) * period_ns)
            seconds = true_ns / _SECOND_NS
            if seconds >= end_s:
                return
            if not any(from_s <= seconds < to_s for from_s, to_s in silences):
                yield true_ns + sensor.latency_ns, order, k, true_ns
            k += 1

    def _silences_s(self, sensor: Sensor, computer: str) -> list[tuple[float, float]]:
        """Return the times during which a computer records nothing of a topic."""
        silences = []
        if self._faults.gap and self._faults.gap.topic == sensor.topic:
            silences.append((self._faults.gap.start_s, self._faults.gap.start_s + self._faults.gap.duration_s))
        whole = self._expected_s
        if self._has(Defect.gap, sensor.topic):
            silences.append((_GAP[0] * whole, _GAP[1] * whole))
        if self._has(Defect.silent_start, sensor.topic) or self._has(Defect.late_computer, computer):
            silences.append((0, _LATE * whole))
        return silences

    def _clock_error_ns(self, computer: str, true_ns: int) -> int:
        """Return by how much the clock of a computer is ahead."""
        error_ns = _RECORDER_OFFSET_NS if self._has(Defect.recorder_offset, computer) else 0
        if self._has(Defect.clock_jump, computer) and true_ns >= self._expected_s * _SECOND_NS / 2:
            error_ns += _CLOCK_JUMP_NS
        return error_ns

    def _stamp_error_ns(self, sensor: Sensor, true_ns: int) -> int:
        """Return by how much the stamps of a topic differ from the clock of its computer."""
        error_ns = _STAMP_OFFSET_NS if self._has(Defect.stamp_offset, sensor.topic) else 0
        if self._has(Defect.stamp_drift, sensor.topic):
            error_ns += round(_STAMP_DRIFT * true_ns)
        if self._has(Defect.stamp_jump, sensor.topic) and true_ns >= self._expected_s * _SECOND_NS / 2:
            error_ns += _STAMP_JUMP_NS
        return error_ns

    def _has(self, defect: Defect, target: str) -> bool:
        return self._robot.has_defect(self._faults.defects, defect, target)
