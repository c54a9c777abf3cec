"""Checks of numeric fields of any message type: NaN and infinity, constant values, ranges.

Fields have dotted names; the elements of a list share the name of the list. Left out are bytes, and fields of the
header unless a glob names them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kleinkram.checks.content.probe import Probe, SampledMessage
from kleinkram.checks.content.rows import number
from kleinkram.checks.document import ValueRule
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError, Value, to_plain

_MAX_FIELDS, _MAX_ITEMS, _SHOWN = 2000, 1000, 5
_SMALL_MESSAGE_BYTES = 4096
_HEADER = "header."


@dataclass
class _FieldFacts:
    """One field over all samples. `first`: its first value; `has_changed`: another one followed."""

    first: tuple[float, ...]
    has_changed: bool = False
    samples: int = 0
    unusable: int = 0
    unusable_ns: int = 0
    lowest: float = np.inf
    lowest_ns: int = 0
    highest: float = -np.inf
    highest_ns: int = 0


class ValueProbe(Probe[ValueRule]):
    """Checks of the numeric fields of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._fields: dict[str, _FieldFacts] = {}
        self._matches: dict[str, bool] = {}
        self._measured = 0

    def measure(self, sample: SampledMessage) -> None:
        """Measure the fields of a sample, and of small messages that were read along with it."""
        if not sample.is_picked and len(sample.message.data) > _SMALL_MESSAGE_BYTES:
            return
        if isinstance(sample.value, bytes):
            raise DecodeError("", "its messages stay bytes")
        self._measured += 1
        by_name: dict[str, list[NDArray[Any]]] = {}
        for name, values in numeric_fields(sample.value):
            if values.size and self._is_selected(name):
                by_name.setdefault(name, []).append(values)
        for name, parts in by_name.items():
            self._note(name, parts[0] if len(parts) == 1 else np.concatenate(parts), sample.log_time_ns)

    def results(self) -> Iterator[Check]:
        """Yield the checks of NaN, constant values and ranges."""
        if not self._fields:
            reason = f"no numeric field matches {', '.join(self.rule.fields[:_SHOWN])}"
            for name in self.names:
                yield self.row(name, CheckStatus.not_made, reason)
            return
        yield self._nan()
        if self.rule.varies:
            yield self._constant()
        if "value.range" in self.names:
            yield self._range()

    def _is_selected(self, name: str) -> bool:
        if name not in self._matches and len(self._matches) < _MAX_FIELDS:
            self._matches[name] = any(
                fnmatchcase(name, glob) and (not name.startswith(_HEADER) or glob.startswith("header"))
                for glob in self.rule.fields
            )
        return self._matches.get(name, False)

    def _note(self, name: str, values: NDArray[Any], time_ns: int) -> None:
        numbers = values.astype(np.float64)
        facts = self._fields.get(name)
        beginning = tuple(numbers[:_MAX_ITEMS].tolist())
        if facts is None:
            facts = self._fields[name] = _FieldFacts(beginning)
        facts.has_changed = facts.has_changed or beginning != facts.first
        facts.samples += 1
        finite = numbers[np.isfinite(numbers)]
        if len(finite) < len(numbers):
            facts.unusable_ns = facts.unusable_ns or time_ns
            facts.unusable += 1
        if not len(finite):
            return
        lowest, highest = float(finite.min()), float(finite.max())
        if lowest < facts.lowest:
            facts.lowest, facts.lowest_ns = lowest, time_ns
        if highest > facts.highest:
            facts.highest, facts.highest_ns = highest, time_ns

    def _nan(self) -> Check:
        limit = self.rule.max_nan
        bad = {name: facts for name, facts in self._fields.items() if facts.unusable > limit * facts.samples}
        worst = max(self._fields.values(), key=lambda facts: facts.unusable / facts.samples)
        message = f"{len(self._fields)} numeric fields are finite"
        if bad:
            message = f"NaN or infinite in {worst.unusable} of {worst.samples} messages: {_listed(bad)}"
        elif worst.unusable:
            message = f"NaN or infinite in at most {worst.unusable} of {worst.samples} messages"
        return self.outcome(
            "value.nan",
            message,
            fails=bool(bad),
            value=worst.unusable / worst.samples,
            limit=limit,
            time_ns=min((facts.unusable_ns for facts in bad.values()), default=None),
        )

    def _constant(self) -> Check:
        if self._measured < 2:
            return self.row("value.constant", CheckStatus.not_made, "there is only one message")
        constant = [name for name, facts in self._fields.items() if not facts.has_changed]
        message = f"constant in {self._measured} messages: {_listed(constant)}" if constant else "all fields change"
        return self.outcome("value.constant", message, fails=bool(constant), value=len(constant), unit="fields")

    def _range(self) -> Check:
        minimum, maximum = self.rule.min, self.rule.max
        below = {name: f for name, f in self._fields.items() if minimum is not None and f.lowest < minimum}
        above = {name: f for name, f in self._fields.items() if maximum is not None and f.highest > maximum}
        if below:
            name, facts = min(below.items(), key=lambda item: item[1].lowest)
            value, limit, time_ns = facts.lowest, minimum, facts.lowest_ns
            message = f"{_listed(below)}: {name} is {number(value)}, less than {number(limit or 0)}"
        elif above:
            name, facts = max(above.items(), key=lambda item: item[1].highest)
            value, limit, time_ns = facts.highest, maximum, facts.highest_ns
            message = f"{_listed(above)}: {name} is {number(value)}, more than {number(limit or 0)}"
        elif all(facts.lowest > facts.highest for facts in self._fields.values()):
            return self.row("value.range", CheckStatus.not_made, "all values are NaN or infinite")
        else:
            lowest = min(facts.lowest for facts in self._fields.values())
            highest = max(facts.highest for facts in self._fields.values())
            message = f"the values are {number(lowest)} to {number(highest)}"
            value, limit, time_ns = (lowest, minimum, 0) if maximum is None else (highest, maximum, 0)
        return self.outcome(
            "value.range", message, fails=bool(below or above), value=value, limit=limit, time_ns=time_ns
        )


def numeric_fields(value: object) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the dotted names and values of all numeric fields of a message of any encoding."""
    is_ros = isinstance(value, Value)
    yield from _walk(value if is_ros or isinstance(value, Mapping) else to_plain(value), "")


def _walk(value: Any, name: str) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, bool | str | bytes) or value is None:
        return
    if isinstance(value, int | float):
        yield name, np.array([float(value)])
    elif isinstance(value, Value):
        for field in value._fields:
            yield from _walk(getattr(value, field), f"{name}.{field}" if name else field)
    elif isinstance(value, Mapping):
        for field, item in value.items():
            yield from _walk(item, f"{name}.{field}" if name else str(field))
    elif isinstance(value, np.ndarray):
        if value.dtype.kind in "iuf" and value.dtype != np.uint8:
            yield name, value.ravel()
    elif isinstance(value, list | tuple):
        yield from _walk_list(value, name)


def _walk_list(values: list[Any] | tuple[Any, ...], name: str) -> Iterator[tuple[str, NDArray[Any]]]:
    numbers = [item for item in values if isinstance(item, int | float) and not isinstance(item, bool)]
    if numbers:
        yield name, np.array(numbers, dtype=np.float64)
        return
    for item in values[:_MAX_ITEMS]:
        yield from _walk(item, name)


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    return ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
