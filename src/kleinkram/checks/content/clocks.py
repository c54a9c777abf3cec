"""Checks of clocks: header stamps against log times, and the log times of two recorders for the same message.

A difference is the stamp minus the log time: negative where a message is recorded after it was measured.
"""

from __future__ import annotations

import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kleinkram.checks.content.probe import (
    FollowUp,
    Probe,
    RecordedTopic,
    SampledMessage,
    checked_stamp,
    measured,
    number,
)
from kleinkram.checks.content.transforms import transforms_of
from kleinkram.checks.document import ClockRule
from kleinkram.checks.outcomes import failed, make_check, seconds
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError

_MAX_DIFFERENCES, _BINS, _FEWEST_BINS = 200_000, 20, 3
_MIN_DRIFT_SPAN_NS = 1_000_000_000
_STANDARD_ERRORS = 2
_MAX_KEYS, _FEWEST_MATCHES, _FOLLOW_UPS = 4096, 3, 5


class StampProbe(Probe[ClockRule]):
    """Checks of the header stamps of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._log_times: list[int] = []
        self._differences: list[int] = []

    def measure(self, sample: SampledMessage) -> None:
        """Keep the difference between stamp and log time."""
        stamp = stamp_of(sample.value) if self.is_exact else sample.stamp_ns
        if stamp is not None and len(self._differences) < _MAX_DIFFERENCES:
            self._log_times.append(sample.log_time_ns)
            self._differences.append(stamp - sample.log_time_ns)

    @property
    def has_stamps(self) -> bool:
        """Whether a message has a stamp, or none could be decoded."""
        return bool(self._differences) or not self.decoded

    def results(self) -> Iterator[Check]:
        """Yield the checks of offset, drift and jumps."""
        if not self._differences:
            for name in self.names:
                yield self.row(name, CheckStatus.not_made, "its messages have no header stamp")
            return
        if self.rule.max_stamp_offset is not None:
            yield self._offset(self.rule.max_stamp_offset)
        if self.rule.max_stamp_drift is not None:
            yield self._drift(self.rule.max_stamp_drift)
        if self.rule.max_stamp_jump is not None:
            yield self._jump(self.rule.max_stamp_jump)

    def _offset(self, limit_ns: int) -> Check:
        offset_ns = median(self._differences)
        side = "before" if offset_ns < 0 else "after"
        return self.outcome(
            "clock.stamp_offset",
            f"its stamps are {seconds(abs(offset_ns))} {side} the log times (median of {len(self._differences)})",
            fails=abs(offset_ns) > limit_ns,
            value=offset_ns / 1e9,
            limit=limit_ns / 1e9,
            unit="s",
            time_ns=self._log_times[0],
        )

    def _drift(self, limit_ppm: float) -> Check:
        """Fit a line to the medians of intervals; a drift within two standard errors of the limit passes."""
        start_ns, span_ns = self._log_times[0], self._log_times[-1] - self._log_times[0]
        bins: dict[int, list[tuple[int, int]]] = defaultdict(list)
        for log_ns, difference_ns in zip(self._log_times, self._differences, strict=True):
            bins[(log_ns - start_ns) * _BINS // (span_ns + 1)].append((log_ns - start_ns, difference_ns))
        if span_ns < _MIN_DRIFT_SPAN_NS or len(bins) < _FEWEST_BINS:
            reason = f"{len(self._differences)} messages over {seconds(span_ns)} are too few to measure a drift"
            return self.row("clock.stamp_drift", CheckStatus.not_made, reason)
        first_ns = self._differences[0]
        times = np.array([median(time_ns for time_ns, _ in members) for members in bins.values()]) / 1e9
        offsets = np.array([median(d - first_ns for _, d in members) for members in bins.values()]) / 1e3
        slope, error = slope_of(times, offsets)
        return self.outcome(
            "clock.stamp_drift",
            f"its stamps drift by {number(slope)} µs/s against the log times (± {number(_STANDARD_ERRORS * error)})",
            fails=abs(slope) - _STANDARD_ERRORS * error > limit_ppm,
            value=slope,
            limit=limit_ppm,
            unit="ppm",
            time_ns=start_ns,
        )

    def _jump(self, limit_ns: int) -> Check:
        steps = [later - earlier for earlier, later in pairwise(self._differences)]
        if not steps:
            return self.row("clock.stamp_jump", CheckStatus.not_made, "there is only one message")
        worst = max(range(len(steps)), key=lambda step: abs(steps[step]))
        return self.outcome(
            "clock.stamp_jump",
            f"its stamps jump by at most {seconds(abs(steps[worst]))} against the log times",
            fails=abs(steps[worst]) > limit_ns,
            value=steps[worst] / 1e9,
            limit=limit_ns / 1e9,
            unit="s",
            time_ns=self._log_times[worst + 1],
        )


def slope_of(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Return the slope of a line through points by least squares, and its standard error."""
    x, y = x - x.mean(), y - y.mean()
    spread = float(x @ x)
    if spread == 0:
        return 0.0, 0.0
    slope = float(x @ y) / spread
    residuals = y - slope * x
    return slope, float(np.sqrt(residuals @ residuals / max(1, len(x) - 2) / spread))


def stamp_of(value: object) -> int | None:
    """Return the stamp of a message, or of the first transform in it. Raises DecodeError."""
    stamp = checked_stamp(value)
    transforms = transforms_of(value) if stamp is None else []
    return checked_stamp(transforms[0]) if transforms else stamp


class _Keys:
    """Log times by what identifies a message; of many, those with the smallest keys, the same ones in each recording.

    A key that occurs twice identifies nothing.
    """

    def __init__(self) -> None:
        self._times: dict[int, int | None] = {}
        self._bound = 2**64

    def add(self, key: int, log_ns: int) -> None:
        if key >= self._bound:
            return
        is_other = key in self._times and self._times[key] != log_ns
        self._times[key] = None if is_other else log_ns
        if len(self._times) > 2 * _MAX_KEYS:
            self._bound = sorted(self._times)[_MAX_KEYS]
            self._times = {known: time_ns for known, time_ns in self._times.items() if known < self._bound}

    def offsets_from(self, reference: _Keys) -> list[tuple[int, int]]:
        """Return log time and its difference from the reference's, for each message that both have."""
        pairs = ((reference._times.get(key), log_ns) for key, log_ns in self._times.items())
        return [(log_ns, log_ns - other) for other, log_ns in pairs if other is not None and log_ns is not None]


class _Recorder:
    """What is known of the topic in one recording."""

    def __init__(self) -> None:
        self.by_bytes, self.by_stamp = _Keys(), _Keys()
        self.differences: list[int] = []
        self.picked: list[int] = []

    def offsets_from(self, reference: _Recorder) -> list[tuple[int, int]]:
        return self.by_bytes.offsets_from(reference.by_bytes) or self.by_stamp.offsets_from(reference.by_stamp)

    def expected_offset_ns(self, reference: _Recorder) -> int:
        """Return by how much its log times are later than the reference's, as far as the stamps show."""
        if not self.differences or not reference.differences:
            return 0
        return round(median(reference.differences) - median(self.differences))


class RecorderProbe(Probe[ClockRule]):
    """The difference between the log times that recordings have for the same messages of one topic.

    Messages are the same if their bytes are; without such, if their stamps are.
    """

    def __init__(
        self, rule: ClockRule, names: tuple[str, ...], streams: tuple[RecordedTopic, ...], *, is_exact: bool
    ) -> None:
        super().__init__(rule, names, streams[0], is_exact=is_exact)
        self._recorders = {stream.recording: _Recorder() for stream in streams}

    def add(self, sample: SampledMessage) -> None:
        """Take a message; it need not be decodable."""
        self.decoded += 1
        self.measure(sample)

    def measure(self, sample: SampledMessage) -> None:
        """Note when a message was recorded."""
        recorder, log_ns = self._recorders[sample.stream.recording], sample.log_time_ns
        recorder.by_bytes.add(_digest(sample.message.data), log_ns)
        if sample.is_picked:
            recorder.picked.append(log_ns)
        try:
            stamp = stamp_of(sample.value)
        except (DecodeError, OverflowError):
            return
        if stamp is not None:
            recorder.by_stamp.add(_digest(stamp.to_bytes(16, "little", signed=True)), log_ns)
            if len(recorder.differences) < _MAX_DIFFERENCES:
                recorder.differences.append(stamp - log_ns)

    def follow_ups(self) -> list[FollowUp]:
        """Return where the reference's samples should be in the recordings that share too few messages with it."""
        reference = self._reference
        if not reference.picked:
            return []
        step = max(1, len(reference.picked) // _FOLLOW_UPS)
        return [
            FollowUp(RecordedTopic(name, self.stream.topic), log_ns + recorder.expected_offset_ns(reference))
            for name, recorder in self._others.items()
            if len(recorder.offsets_from(reference)) < _FEWEST_MATCHES
            for log_ns in reference.picked[step // 2 :: step][:_FOLLOW_UPS]
        ]

    def results(self) -> Iterator[Check]:
        """Yield the offset of each recording from the first."""
        limit_ns = self.rule.max_recorder_offset or 0
        for name, recorder in self._others.items():
            offsets = recorder.offsets_from(self._reference)
            if not offsets:
                reason = f"no message of it is in the samples of both {self.stream.recording} and {name}"
                yield self._row_of(name, CheckStatus.not_made, reason)
                continue
            offset_ns = median(offset for _, offset in offsets)
            fails = abs(offset_ns) > limit_ns
            side = "later" if offset_ns > 0 else "earlier"
            message = (
                f"{name} recorded it {seconds(abs(offset_ns))} {side} than {self.stream.recording} "
                f"(median of {len(offsets)} messages)"
            )
            status = failed(self.rule.severity) if fails else CheckStatus.ok
            time_ns = min(log_ns for log_ns, _ in offsets) if fails else None
            yield self._row_of(name, status, message, value=offset_ns / 1e9, time_ns=time_ns)

    @property
    def _reference(self) -> _Recorder:
        return self._recorders[self.stream.recording]

    @property
    def _others(self) -> Mapping[str, _Recorder]:
        return {name: item for name, item in self._recorders.items() if name != self.stream.recording}

    def _row_of(
        self, recording: str, status: CheckStatus, message: str, value: float | None = None, time_ns: int | None = None
    ) -> Check:
        limit = (self.rule.max_recorder_offset or 0) / 1e9
        return make_check(
            self.names[0],
            status,
            message,
            topic=self.stream.topic,
            file=recording,
            time_ns=time_ns,
            measured=measured(value, limit, "s"),
        )


def _digest(data: bytes) -> int:
    """Return 64 bits that differ for different data, spread evenly."""
    return zlib.crc32(data) << 32 | zlib.crc32(data, 0x9E3779B9) ^ zlib.adler32(data)
