"""Thinned positions: GNSS fixes, and poses of odometry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kleinkram.recordings.previews.columns import Columns
from kleinkram.recordings.previews.model import PositionTrack, TrackKind

MAX_POSITIONS = 2_000
_POSE_PREFIXES = ("pose.pose.position", "pose.position", "transform.translation")
_STATUS = "status.status"  # of sensor_msgs/NavSatFix: -1 is "no fix"


class PositionSampler:
    """Keeps every n-th position of one topic, and the last one; n doubles when there are too many."""

    def __init__(self, topic: str, *, is_pose: bool) -> None:
        self._topic = topic
        self._is_pose = is_pose
        self._kind: TrackKind | None = None
        self._count = 0
        self._stride = 1
        self._rows: list[NDArray[np.float64]] = []
        self._times_ns: list[NDArray[np.int64]] = []
        self._last: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None

    def add(self, times_ns: NDArray[np.int64], columns: Columns) -> None:
        """Add messages; those without a position that can be used are left out."""
        names = self._names(columns)
        if names is None:
            return
        missing = np.full(len(times_ns), np.nan)
        rows = np.stack([columns.get(name, missing) for name in names], axis=1)
        usable = np.isfinite(rows[:, :2]).all(axis=1)
        if self._kind is TrackKind.gnss and _STATUS in columns:
            usable &= ~(columns[_STATUS] < 0)
        rows, times_ns = rows[usable], times_ns[usable]
        if not len(rows):
            return
        chosen = (self._count + np.arange(len(rows))) % self._stride == 0
        self._rows.append(rows[chosen])
        self._times_ns.append(times_ns[chosen])
        self._last = times_ns[-1:], rows[-1:]
        self._count += len(rows)
        if sum(map(len, self._rows)) > MAX_POSITIONS:
            self._thin()

    def track(self) -> PositionTrack | None:
        """Return the track; None without positions."""
        if self._kind is None or self._last is None:
            return None
        times_ns, rows = np.concatenate(self._times_ns), np.concatenate(self._rows)
        if (self._count - 1) % self._stride:
            times_ns, rows = np.concatenate([times_ns, self._last[0]]), np.concatenate([rows, self._last[1]])
        return PositionTrack(self._topic, self._kind, self._count, times_ns, rows)

    def _names(self, columns: Columns) -> tuple[str, str, str] | None:
        if "latitude" in columns and "longitude" in columns:
            self._kind = TrackKind.gnss
            return "latitude", "longitude", "altitude"
        for prefix in _POSE_PREFIXES if self._is_pose else ():
            if f"{prefix}.x" in columns and f"{prefix}.y" in columns:
                self._kind = TrackKind.pose
                return f"{prefix}.x", f"{prefix}.y", f"{prefix}.z"
        return None

    def _thin(self) -> None:
        while sum(map(len, self._rows)) > MAX_POSITIONS:
            self._rows = [np.concatenate(self._rows)[::2]]
            self._times_ns = [np.concatenate(self._times_ns)[::2]]
            self._stride *= 2
