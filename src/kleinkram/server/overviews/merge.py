"""The topics of many files -> those of their mission. Holds one topic at a time, whatever the number of files. Pure."""

import uuid
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from sqlalchemy import Row

from kleinkram.recordings.density import add_up, unpack
from kleinkram.recordings.model import MessageDensity
from kleinkram.recordings.timeline import StampRun, join

_ADDED_AT_ONCE = 64


class Key(NamedTuple):
    """What topics are merged by."""

    name: str
    message_type: str | None


@dataclass(frozen=True)
class Merged:
    """One topic with one type in all recordings of a mission, as `MissionTopic` says; `places` are flat ranges."""

    key: Key
    count: int | None
    file_count: int
    recording_count: int
    places: list[int]
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    longest_gap_ns: int | None
    stored_bytes: int | None
    density: MessageDensity | None


async def merge(rows: AsyncIterator[Row[Any]], recording_ids: Sequence[uuid.UUID]) -> AsyncIterator[Merged]:
    """Yield merged topics of rows that come by name, type, recording and time; rows that are not placed only count."""
    places = {recording_id: place for place, recording_id in enumerate(recording_ids)}
    one: _One | None = None
    async for row in rows:
        key = Key(row.name, row.message_type)
        if one is None or one.key != key:
            if one is not None:
                yield one.merged(places)
            one = _One(key)
        one.add(row)
    if one is not None:
        yield one.merged(places)


class _One:
    """A topic on the way."""

    def __init__(self, key: Key) -> None:
        self.key = key
        self._files = 0
        self._count: int | None = 0
        self._stored_bytes: int | None = 0
        self._recordings: set[uuid.UUID] = set()
        self._recording_id: uuid.UUID | None = None
        self._runs: list[StampRun] = []
        self._whole = _Whole()
        self._densities: list[MessageDensity] = []

    def add(self, row: Row[Any]) -> None:
        if row.recording_id != self._recording_id:
            self._end_recording()
            self._recording_id = row.recording_id
        self._files += 1
        self._count = _sum(self._count, row.message_count)
        self._stored_bytes = _sum(self._stored_bytes, row.stored_bytes)
        if row.message_count != 0 and row.recording_id is not None:
            self._recordings.add(row.recording_id)
        if row.is_placed:
            gap_ns = row.longest_gap_ns or 0
            self._runs.append(StampRun(row.first_ns, row.last_ns, row.message_count or 0, gap_ns))
            if row.density is not None:
                self._densities.append(unpack(row.density))
        if len(self._densities) >= _ADDED_AT_ONCE:
            self._densities = [*_added(self._densities)]

    def merged(self, places: Mapping[uuid.UUID, int]) -> Merged:
        self._end_recording()
        found = sorted(places[each] for each in self._recordings if each in places)
        whole = self._whole
        return Merged(
            key=self.key,
            count=self._count,
            file_count=self._files,
            recording_count=len(found),
            places=[*_ranges(found)],
            first_ns=whole.first_ns,
            last_ns=whole.last_ns,
            rate_hz=whole.steps * 1e9 / whole.span_ns if whole.span_ns > 0 and whole.steps > 0 else None,
            longest_gap_ns=whole.longest_gap_ns if whole.steps > 0 else None,
            stored_bytes=self._stored_bytes,
            density=next(_added(self._densities), None),
        )

    def _end_recording(self) -> None:
        # A file without a recording stands for itself.
        runs = join(self._runs) if self._recording_id is not None else self._runs
        for run in runs:
            self._whole.add(run)
        self._runs = []


@dataclass
class _Whole:
    """All recordings of one topic."""

    first_ns: int | None = None
    last_ns: int | None = None
    steps: int = 0
    span_ns: int = 0
    longest_gap_ns: int = 0

    def add(self, run: StampRun) -> None:
        self.first_ns = run.first_ns if self.first_ns is None else min(self.first_ns, run.first_ns)
        self.last_ns = run.last_ns if self.last_ns is None else max(self.last_ns, run.last_ns)
        self.steps += max(0, run.count - 1)
        self.span_ns += run.last_ns - run.first_ns
        self.longest_gap_ns = max(self.longest_gap_ns, run.longest_gap_ns)


def _added(densities: Sequence[MessageDensity]) -> Iterator[MessageDensity]:
    total = add_up(densities)
    if total is not None:
        yield total


def _sum(total: int | None, more: int | None) -> int | None:
    return None if total is None or more is None else total + more


def _ranges(numbers: Sequence[int]) -> Iterator[int]:
    """Yield first and last of each range of sorted numbers that follow each other."""
    for at, number in enumerate(numbers):
        if at == 0 or numbers[at - 1] != number - 1:
            yield number
        if at == len(numbers) - 1 or numbers[at + 1] != number + 1:
            yield number
