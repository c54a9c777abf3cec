"""Checks of batteries: state of charge and voltage.

Source: sensor_msgs/BatteryState: a percentage from 0 to 1, NaN where it is not measured. Drivers that give 0 to 100
are recognised by values above 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from kleinkram.checks.content.probe import Probe, SampledMessage, number
from kleinkram.checks.document import BatteryRule
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.decoding.values import part, type_name


class BatteryProbe(Probe[BatteryRule]):
    """The check of the battery states of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._lowest: dict[str, tuple[float, int]] = {}
        self._highest_charge = 0.0

    def measure(self, sample: SampledMessage) -> None:
        """Keep the lowest values."""
        for field in ("percentage", "voltage"):
            try:
                value = float(part(sample.value, field))
            except (TypeError, ValueError):
                raise DecodeError(type_name(sample.value), f"it has no {field}") from None
            if math.isfinite(value) and value < self._lowest.get(field, (math.inf, 0))[0]:
                self._lowest[field] = value, sample.log_time_ns
            if field == "percentage" and math.isfinite(value):
                self._highest_charge = max(self._highest_charge, value)

    def results(self) -> Iterator[Check]:
        """Yield the check of each quantity with a limit."""
        limits = {"percentage": self.rule.min_percentage, "voltage": self.rule.min_voltage}
        for field, limit in limits.items():
            if limit is None:
                continue
            if field not in self._lowest:
                yield self.row("battery.low", CheckStatus.not_made, f"its {field} is not measured")
                continue
            value, time_ns = self._lowest[field]
            if field == "percentage" and self._highest_charge > 1:
                value /= 100
            shown = f"{value:.0%}" if field == "percentage" else f"{number(value)} V"
            what = "state of charge" if field == "percentage" else "voltage"
            yield self.outcome(
                "battery.low",
                f"its lowest {what} is {shown}",
                fails=value < limit,
                value=value,
                limit=limit,
                unit=None if field == "percentage" else "V",
                time_ns=time_ns,
            )
