"""Least and greatest values of numeric fields in bins of equally many messages, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kleinkram.recordings.previews.columns import MAX_FIELDS, Columns
from kleinkram.recordings.previews.model import FieldSeries, TopicSeries

MAX_BINS = 4_000
"""With more messages than that, a topic has at least half as many bins."""


@dataclass
class FieldBudget:
    """How many more fields, of all topics, may have bins."""

    fields: int


class BinnedFields:
    """Bins of one topic. When there are too many, each two become one, of twice as many messages."""

    def __init__(self, budget: FieldBudget) -> None:
        self._budget = budget
        self._count = 0
        self._per_bin = 1
        self._first_ns = np.empty(0, np.int64)
        self._last_ns = np.empty(0, np.int64)
        self._low: dict[str, NDArray[np.float64]] = {}
        self._high: dict[str, NDArray[np.float64]] = {}
        self.left_out_fields = False

    def add(self, times_ns: NDArray[np.int64], columns: Columns) -> None:
        """Add messages; `times_ns` and all columns have the same length."""
        if not len(times_ns):
            return
        while -(-(self._count + len(times_ns)) // self._per_bin) > MAX_BINS:
            self._halve()
        bins = (self._count + np.arange(len(times_ns))) // self._per_bin
        starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
        numbers = bins[starts]
        self._grow(int(numbers[-1]) + 1, columns)
        ends = np.append(starts[1:], len(times_ns)) - 1
        is_continued = self._count % self._per_bin != 0
        self._first_ns[numbers[int(is_continued) :]] = times_ns[starts[int(is_continued) :]]
        self._last_ns[numbers] = times_ns[ends]
        for name, values in columns.items():
            if name in self._low:
                low, high = self._low[name], self._high[name]
                low[numbers] = np.fmin(low[numbers], np.fmin.reduceat(values, starts))
                high[numbers] = np.fmax(high[numbers], np.fmax.reduceat(values, starts))
        self._count += len(times_ns)

    def series(self, topic: str, message_type: str, *, is_sampled: bool) -> TopicSeries:
        """Return the bins; fields that never had a number are left out."""
        fields = tuple(
            FieldSeries(name, low, self._high[name]) for name, low in self._low.items() if not np.isnan(low).all()
        )
        return TopicSeries(
            topic, message_type, self._count, self._per_bin, self._first_ns, self._last_ns, fields, is_sampled
        )

    def _halve(self) -> None:
        self._per_bin *= 2
        self._first_ns, self._last_ns = self._first_ns[::2], pairs(self._last_ns, np.maximum)
        for name in self._low:
            self._low[name] = pairs(self._low[name], np.fmin)
            self._high[name] = pairs(self._high[name], np.fmax)

    def _grow(self, length: int, columns: Columns) -> None:
        for name in columns:
            if name in self._low:
                continue
            if len(self._low) >= MAX_FIELDS or not self._budget.fields:
                self.left_out_fields = True
                continue
            self._budget.fields -= 1
            self._low[name] = np.full(len(self._first_ns), np.nan)
            self._high[name] = self._low[name].copy()
        missing = length - len(self._first_ns)
        self._first_ns = np.append(self._first_ns, np.zeros(missing, np.int64))
        self._last_ns = np.append(self._last_ns, np.zeros(missing, np.int64))
        unknown = np.full(missing, np.nan)
        for values in (self._low, self._high):
            for name, before in values.items():
                values[name] = np.append(before, unknown)


def pairs(values: NDArray[Any], combine: np.ufunc) -> NDArray[Any]:
    """Return each two consecutive values as one; the last of an odd number stays alone."""
    whole = len(values) // 2 * 2
    combined = combine(values[:whole:2], values[1:whole:2])
    return np.concatenate([combined, values[whole:]])


def halved(series: TopicSeries) -> TopicSeries:
    """Return a series with half as many bins."""
    fields = tuple(
        FieldSeries(field.name, pairs(field.low, np.fmin), pairs(field.high, np.fmax)) for field in series.fields
    )
    return TopicSeries(
        series.topic,
        series.message_type,
        series.message_count,
        2 * series.messages_per_bin,
        series.first_ns[::2],
        pairs(series.last_ns, np.maximum),
        fields,
        series.is_sampled,
    )
