"""Known defects of sample missions, and the faults that are put into a drive."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from enum import Enum
from typing import NoReturn


class Defect(str, Enum):
    """A defect that a check can find. What it affects depends on the robot: see `Robot.targets`."""

    gap = "gap"
    wrong_rate = "wrong-rate"
    dropped_topic = "dropped-topic"
    wrong_type = "wrong-type"
    repeated_static = "repeated-static"
    silent_start = "silent-start"
    silent_end = "silent-end"
    clock_jump = "clock-jump"
    stamp_offset = "stamp-offset"
    stamp_drift = "stamp-drift"
    stamp_jump = "stamp-jump"
    black_camera = "black-camera"
    overexposed_camera = "overexposed-camera"
    frozen_camera = "frozen-camera"
    blurred_camera = "blurred-camera"
    tilted_gravity = "tilted-gravity"
    wrong_gravity = "wrong-gravity"
    saturated_imu = "saturated-imu"
    constant_imu = "constant-imu"
    no_fix = "no-fix"
    position_jump = "position-jump"
    empty_clouds = "empty-clouds"
    far_points = "far-points"
    disconnected_tf = "disconnected-tf"
    odometry_jump = "odometry-jump"
    nan = "nan"
    stuck_value = "stuck-value"
    value_range = "value-range"
    low_battery = "low-battery"
    truncated = "truncated"
    missing_computer = "missing-computer"
    late_computer = "late-computer"
    early_end = "early-end"
    empty_recording = "empty-recording"
    recorder_offset = "recorder-offset"
    missing_file = "missing-file"

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        names = [defect.value for defect in cls]
        similar = get_close_matches(str(value), names, n=1)
        hint = f"did you mean {similar[0]!r}?" if similar else f"the defects are {', '.join(names)}"
        raise ValueError(f"no defect is called {value!r}; {hint}")


@dataclass(frozen=True)
class TopicGap:
    """A topic has no messages from `start_s` on for `duration_s`."""

    topic: str
    start_s: float
    duration_s: float


@dataclass(frozen=True)
class Faults:
    """Faults of a sample mission. `truncate_to`: remaining share of each data file, such as 0.6."""

    dropped_topic: str | None = None
    gap: TopicGap | None = None
    truncate_to: float | None = None
    defects: frozenset[Defect] = frozenset()
