"""Checks of point clouds: empty ones, and the distances of their points.

A point is usable if its coordinates are finite and not all 0, which is how sensors mark a missing return.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from kleinkram.checks.content.probe import Probe, SampledMessage, number
from kleinkram.checks.document import PointCloudRule
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError, points
from kleinkram.recordings.decoding.values import type_name


class PointCloudProbe(Probe[PointCloudRule]):
    """Checks of the point clouds of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._counts: list[int] = []
        self._empty_ns: int | None = None
        self._outside = 0
        self._outside_ns: int | None = None
        self._nearest, self._farthest = np.inf, 0.0

    def measure(self, sample: SampledMessage) -> None:
        """Measure a cloud that is among the samples."""
        if not sample.is_picked:
            return
        cloud = points(sample.value)
        if not {"x", "y", "z"} <= set(cloud.dtype.names or ()):
            raise DecodeError(type_name(sample.value), "its points have no x, y and z")
        xyz = np.stack([np.ravel(cloud[axis]).astype(np.float64) for axis in "xyz"], axis=-1)
        xyz = xyz[np.isfinite(xyz).all(axis=1) & xyz.any(axis=1)]
        self._counts.append(len(xyz))
        if len(xyz) < self.rule.min_points and self._empty_ns is None:
            self._empty_ns = sample.log_time_ns
        if not len(xyz):
            return
        ranges = np.sqrt((xyz * xyz).sum(axis=1))
        self._nearest = min(self._nearest, float(ranges.min()))
        self._farthest = max(self._farthest, float(ranges.max()))
        is_outside = ranges < self.rule.min_range
        if self.rule.max_range is not None:
            is_outside |= ranges > self.rule.max_range
        outside = int(is_outside.sum())
        self._outside += outside
        if outside and self._outside_ns is None:
            self._outside_ns = sample.log_time_ns

    def results(self) -> Iterator[Check]:
        """Yield the checks of empty clouds and of ranges."""
        if not self._counts:
            for name in self.names:
                yield self.row(name, CheckStatus.not_made, "no cloud was among the samples")
            return
        yield self._empty()
        if "cloud.range" in self.names:
            yield self._range()

    def _empty(self) -> Check:
        count, limit = len(self._counts), self.rule.min_points
        empty = sum(size < limit for size in self._counts)
        decisive = sorted(self._counts)[min(count - 1, int(self.rule.allowed * count))]
        return self.outcome(
            "cloud.empty",
            f"{empty} of {count} clouds have fewer than {limit} finite {'point' if limit == 1 else 'points'}",
            fails=empty > self.rule.allowed * count,
            value=decisive,
            limit=limit,
            unit="points",
            time_ns=self._empty_ns,
        )

    def _range(self) -> Check:
        total = sum(self._counts)
        if not total:
            return self.row("cloud.range", CheckStatus.not_made, "the clouds have no finite points")
        share = self._outside / total
        farthest = "" if self.rule.max_range is None else f" to {number(self.rule.max_range)} m"
        return self.outcome(
            "cloud.range",
            f"{self._outside} of {total} points are outside of {number(self.rule.min_range)} m{farthest}: "
            f"the points are {number(self._nearest)} m to {number(self._farthest)} m away",
            fails=share > self.rule.allowed,
            value=share,
            limit=self.rule.allowed,
            time_ns=self._outside_ns,
        )
