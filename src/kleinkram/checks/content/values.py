"""Checks of numeric fields of any message type: NaN and infinity, constant values, ranges.

Fields have dotted names; the elements of a list share the name of the list. Left out are bytes, and fields of
headers unless a glob names them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kleinkram.checks.content.probe import Probe, SampledMessage, number
from kleinkram.checks.document import ValueRule
from kleinkram.checks.globs import matches
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError, Value, to_plain

_MAX_FIELDS, _MAX_ITEMS, _SHOWN = 2000, 1000, 5
_SMALL_MESSAGE_BYTES, _MAX_MESSAGES = 4096, 100_000
_BUFFERED_MESSAGES, _BUFFERED_ELEMENTS = 1024, 1_000_000
_HEADER = "header"


@dataclass
class _FieldFacts:
    """One field over all samples. `first`: its first value; `has_changed`: another one followed."""

    first: NDArray[np.float64]
    has_changed: bool = False
    samples: int = 0
    unusable: int = 0
    unusable_ns: int = 0
    lowest: float = np.inf
    lowest_ns: int = 0
    highest: float = -np.inf
    highest_ns: int = 0

    def add(self, values: NDArray[np.float64], times: Sequence[int]) -> None:
        """Add the values [N, K] of N messages."""
        finite = np.isfinite(values)
        unusable = ~finite.all(axis=1)
        self.samples += len(values)
        if unusable.any():
            self.unusable_ns = self.unusable_ns or times[int(unusable.argmax())]
            self.unusable += int(unusable.sum())
        if not self.has_changed:
            self.has_changed = values.shape[1:] != self.first.shape or bool((values != self.first).any())
        lowest = np.where(finite, values, np.inf).min(axis=1)
        highest = np.where(finite, values, -np.inf).max(axis=1)
        low, high = int(lowest.argmin()), int(highest.argmax())
        if lowest[low] < self.lowest:
            self.lowest, self.lowest_ns = float(lowest[low]), times[low]
        if highest[high] > self.highest:
            self.highest, self.highest_ns = float(highest[high]), times[high]


@dataclass
class _Layout:
    """Where the numbers of one ROS type are: single ones, arrays, and fields that are lists of messages.

    `numbers` and `arrays` return what is at `number_names` and `array_names`.
    """

    number_names: tuple[str, ...]
    array_names: tuple[str, ...]
    list_names: tuple[str, ...]
    numbers: Callable[[object], tuple[Any, ...]]
    arrays: Callable[[object], tuple[Any, ...]]
    lists: Callable[[object], tuple[Any, ...]]


class _Buffer:
    """Values of messages of one layout that wait to be added together, because that is 20 times faster."""

    def __init__(self, layout: _Layout, facts: dict[str, _FieldFacts]) -> None:
        self._layout, self._facts = layout, facts
        self._clear()

    def _clear(self) -> None:
        self._times: list[int] = []
        self._rows: list[tuple[Any, ...]] = []
        self._arrays: list[tuple[Any, ...]] = []
        self._elements = 0

    def add(self, value: object, time_ns: int) -> None:
        """Add a message."""
        self._times.append(time_ns)
        if self._layout.number_names:
            self._rows.append(self._layout.numbers(value))
        if self._layout.array_names:
            arrays = self._layout.arrays(value)
            self._elements += sum(array.size for array in arrays)
            self._arrays.append(arrays)
        if len(self._times) >= _BUFFERED_MESSAGES or self._elements >= _BUFFERED_ELEMENTS:
            self.flush()

    def flush(self) -> None:
        """Add what is buffered to the facts."""
        if self._rows:
            table = np.array(self._rows, dtype=np.float64)
            for column, name in enumerate(self._layout.number_names):
                note_values(self._facts, name, table[:, column : column + 1], self._times)
        for column, name in enumerate(self._layout.array_names if self._arrays else ()):
            arrays = [row[column] for row in self._arrays]
            if len({array.size for array in arrays}) == 1:
                table = np.stack([array.ravel() for array in arrays]).astype(np.float64)
                note_values(self._facts, name, table, self._times)
                continue
            for array, time_ns in zip(arrays, self._times, strict=True):
                note_values(self._facts, name, array.astype(np.float64).reshape(1, -1), [time_ns])
        self._clear()


class ValueProbe(Probe[ValueRule]):
    """Checks of the numeric fields of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._fields: dict[str, _FieldFacts] = {}
        self._selected: dict[str, bool] = {}
        self._buffers: dict[type[Value], tuple[_Layout, _Buffer]] = {}
        self._measured = 0

    def measure(self, sample: SampledMessage) -> None:
        """Measure the fields of a sample, and of small messages that were read along with it."""
        is_small = len(sample.message.data) <= _SMALL_MESSAGE_BYTES
        if not sample.is_picked and (not is_small or self._measured >= _MAX_MESSAGES):
            return
        if isinstance(sample.value, bytes):
            raise DecodeError("", "its messages stay bytes")
        self._measured += 1
        value, time_ns = sample.value, sample.log_time_ns
        if not isinstance(value, Value):
            self._add_fields(_walk(value if isinstance(value, Mapping) else to_plain(value), ""), time_ns)
            return
        if type(value) not in self._buffers:
            layout = _layout_of(value, self._is_selected)
            self._buffers[type(value)] = layout, _Buffer(layout, self._fields)
        layout, buffer = self._buffers[type(value)]
        buffer.add(value, time_ns)
        for name, items in zip(layout.list_names, layout.lists(value), strict=True):
            self._add_fields(_walk(items, name), time_ns)

    def _add_fields(self, fields: Iterable[tuple[str, NDArray[Any]]], time_ns: int) -> None:
        by_name: dict[str, list[NDArray[Any]]] = {}
        for name, values in fields:
            if values.size and self._is_selected(name):
                by_name.setdefault(name, []).append(values)
        for name, parts in by_name.items():
            values = np.concatenate(parts).astype(np.float64).reshape(1, -1)
            note_values(self._fields, name, values, [time_ns])

    @property
    def has_fields(self) -> bool:
        """Whether a selected field has a number, or no message could be decoded."""
        self._flush()
        return bool(self._fields) or not self.decoded

    def _flush(self) -> None:
        for _, buffer in self._buffers.values():
            buffer.flush()

    def results(self) -> Iterator[Check]:
        """Yield the checks of NaN, constant values and ranges."""
        self._flush()
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
        if name not in self._selected and len(self._selected) < _MAX_FIELDS:
            self._selected[name] = any(
                matches(name, glob) and (_HEADER not in name.split(".") or _HEADER in glob) for glob in self.rule.fields
            )
        return self._selected.get(name, False)

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


def note_values(facts: dict[str, _FieldFacts], name: str, values: NDArray[np.float64], times: Sequence[int]) -> None:
    """Add the values [N, K] of a field to its facts; K is 0 for an empty array."""
    if values.shape[1]:
        if name not in facts:
            facts[name] = _FieldFacts(values[0])
        facts[name].add(values, times)


def _layout_of(value: Value, is_selected: Callable[[str], bool]) -> _Layout:
    """Return where the numbers of a type are, by one of its messages: the kinds of its fields never change."""
    names: dict[str, list[str]] = {"numbers": [], "arrays": [], "lists": []}
    waiting: list[tuple[str, Any]] = [("", value)]
    while waiting:
        name, item = waiting.pop()
        if isinstance(item, Value):
            waiting += [(f"{name}.{field}" if name else field, getattr(item, field)) for field in item._fields]
        elif isinstance(item, list | tuple):
            names["lists"].append(name)
        elif isinstance(item, np.ndarray):
            if item.dtype.kind in "iuf" and item.dtype != np.uint8 and is_selected(name):
                names["arrays"].append(name)
        elif isinstance(item, int | float) and not isinstance(item, bool) and is_selected(name):
            names["numbers"].append(name)
    numbers, arrays, lists = (tuple(sorted(group)) for group in names.values())
    return _Layout(numbers, arrays, lists, *(_getter(group) for group in (numbers, arrays, lists)))


def _getter(names: tuple[str, ...]) -> Callable[[object], tuple[Any, ...]]:
    if not names:
        return lambda _value: ()
    if len(names) == 1:
        single = attrgetter(names[0])
        return lambda value: (single(value),)
    return attrgetter(*names)


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
