"""Stores the merged topics of a mission when its files change, and lists them.

For people who see only some of the files, and while nothing is stored, the topics are merged for the request. Merging
holds one topic in memory at a time.
"""

import uuid
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from sqlalchemy import Row, Select, delete, insert

from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import MissionTopic, MissionTopics, RecordingRef, TimeAxis
from kleinkram.recordings.message_density import add_up, on_axis, pack, unpack
from kleinkram.recordings.model import MessageDensity
from kleinkram.recordings.timeline import StampSpan, join_spans
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection
from kleinkram.server.missions import service as missions
from kleinkram.server.overviews import queries
from kleinkram.server.pagination import PageRequest, fetch_page
from kleinkram.server.tables import MAX_STORED_TOPICS, mission_topic

_ADDED_AT_ONCE = 64


class TopicKey(NamedTuple):
    """Key by which topics are merged."""

    name: str
    message_type: str | None


@dataclass(frozen=True)
class MergedTopic:
    """One topic with one type in all recordings of a mission, as in `MissionTopic`."""

    key: TopicKey
    count: int | None
    file_count: int
    recording_count: int
    recording_ranges: list[int]
    first_ns: int | None
    last_ns: int | None
    rate_hz: float | None
    longest_gap_ns: int | None
    stored_bytes: int | None
    density: MessageDensity | None


async def merge(rows: AsyncIterator[Row[Any]], recording_ids: Sequence[uuid.UUID]) -> AsyncIterator[MergedTopic]:
    """Yield merged topics of rows by name, type, recording and time; rows of other recordings are only counted."""
    positions = {recording_id: position for position, recording_id in enumerate(recording_ids)}
    one: _TopicMerger | None = None
    async for row in rows:
        key = TopicKey(row.name, row.message_type)
        if one is None or one.key != key:
            if one is not None:
                yield one.merged(positions)
            one = _TopicMerger(key)
        one.add(row)
    if one is not None:
        yield one.merged(positions)


class _TopicMerger:
    """Accumulates the rows of one topic."""

    def __init__(self, key: TopicKey) -> None:
        self.key = key
        self._files = 0
        self._count: int | None = 0
        self._stored_bytes: int | None = 0
        self._recordings: set[uuid.UUID] = set()
        self._recording_id: uuid.UUID | None = None
        self._runs: list[StampSpan] = []
        self._whole = _TopicTotals()
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
            self._runs.append(StampSpan(row.first_ns, row.last_ns, row.message_count or 0, gap_ns))
            if row.density is not None:
                self._densities.append(unpack(row.density))
        if len(self._densities) >= _ADDED_AT_ONCE:
            self._densities = [*_added(self._densities)]

    def merged(self, positions: Mapping[uuid.UUID, int]) -> MergedTopic:
        self._end_recording()
        numbers = sorted(positions[recording_id] for recording_id in self._recordings if recording_id in positions)
        whole = self._whole
        return MergedTopic(
            key=self.key,
            count=self._count,
            file_count=self._files,
            recording_count=len(numbers),
            recording_ranges=[*_ranges(numbers)],
            first_ns=whole.first_ns,
            last_ns=whole.last_ns,
            rate_hz=whole.steps * 1e9 / whole.span_ns if whole.span_ns > 0 and whole.steps > 0 else None,
            longest_gap_ns=whole.longest_gap_ns if whole.steps > 0 else None,
            stored_bytes=self._stored_bytes,
            density=next(_added(self._densities), None),
        )

    def _end_recording(self) -> None:
        # Files without a recording are not joined.
        runs = join_spans(self._runs) if self._recording_id is not None else self._runs
        for run in runs:
            self._whole.add(run)
        self._runs = []


@dataclass
class _TopicTotals:
    """Totals of one topic over all recordings."""

    first_ns: int | None = None
    last_ns: int | None = None
    steps: int = 0
    span_ns: int = 0
    longest_gap_ns: int = 0

    def add(self, run: StampSpan) -> None:
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


_FETCHED_AT_ONCE = 2_000
_MAX_BIGINT = 2**63 - 1


@dataclass(frozen=True)
class _MissionTopicData:
    """The topics of a mission: its time span, its recordings, and a part or all of its topics."""

    span: tuple[int | None, int | None]
    bin_ns: int
    recordings: list[RecordingRef]
    topics: list[MergedTopic]
    types: dict[str, list[str | None]]
    next: str | None
    is_current: bool


async def list_mission_topics(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, bins: int, page: PageRequest
) -> MissionTopics:
    """Return a page of the topics of a mission, with their counts in at most `bins` bins.

    Raises:
        NotFound: the mission does not exist, or is not visible.
        InvalidCursor: the cursor belongs to another list.
    """
    state = (await db.execute(queries.mission_topics_state(actor, mission_id))).one_or_none()
    if state is None:
        raise NotFound(resource_type="mission", ref=str(mission_id))
    if sees_whole_missions(actor) and state.revision is not None:
        topics = await _stored_topics(db, state, mission_id, page)
    else:
        topics = await _summed_topics(db, actor, state, mission_id)
    axis = _axis(topics, bins)
    return MissionTopics(
        axis=axis,
        recordings=topics.recordings,
        items=[
            _topic(merged, topics.types.get(merged.key.name, []), axis if bins else None) for merged in topics.topics
        ],
        next=topics.next,
        is_current=topics.is_current,
    )


async def store_topics(db: Connection, mission_id: uuid.UUID) -> None:
    """Derive a mission's topics from its files, and replace the stored topics of an earlier state.

    Reads up to hundreds of thousands of rows, a few at a time, and locks the mission only to write.
    """
    state = (await db.execute(queries.mission_state(mission_id))).one_or_none()
    if state is None:
        return
    recordings = (await db.execute(queries.recordings_in_time(mission_id))).all()
    ids = [row.id for row in recordings]
    topics = await _merged(db, queries.topics_of_files(mission_id, state.start_ns, state.end_ns), ids)
    if not await missions.lock_mission(db, mission_id):
        return
    bin_ns = max((merged.density.bin_ns for merged in topics if merged.density), default=1)
    header = {"mission_id": mission_id, "revision": state.files_revision, "recording_ids": ids, "bin_ns": bin_ns}
    if (await db.execute(queries.upsert_topics_header(**header))).first() is None:
        return
    await db.execute(delete(mission_topic).where(mission_topic.c.mission_id == mission_id))
    if topics:
        await db.execute(insert(mission_topic), [_values(mission_id, merged) for merged in topics])


async def _merged(db: Connection, statement: Select[Any], recording_ids: Sequence[uuid.UUID]) -> list[MergedTopic]:
    topics: list[MergedTopic] = []
    async for merged in merge(_streamed(db, statement), recording_ids):
        topics.append(merged)
        if len(topics) == MAX_STORED_TOPICS:
            break
    return topics


async def _streamed(db: Connection, statement: Select[Any]) -> AsyncIterator[Row[Any]]:
    result = await db.stream(statement.execution_options(yield_per=_FETCHED_AT_ONCE))
    try:
        async for rows in result.partitions():
            for row in rows:
                yield row
    finally:
        await result.close()


async def _stored_topics(
    db: Connection, state: Row[Any], mission_id: uuid.UUID, page: PageRequest
) -> _MissionTopicData:
    rows = await fetch_page(db, queries.derived_topics(mission_id), queries.DERIVED_TOPIC_ORDER, page)
    recordings = (await db.execute(queries.recordings_by_id(mission_id))).all()
    return _MissionTopicData(
        span=(state.start_ns, state.end_ns),
        bin_ns=state.bin_ns,
        recordings=[RecordingRef(id=row.id, name=row.name or "") for row in recordings],
        topics=[_from_row(row) for row in rows.items],
        types={row.name: row.types for row in rows.items},
        next=rows.next,
        is_current=state.revision == state.files_revision,
    )


async def _summed_topics(db: Connection, actor: Actor, state: Row[Any], mission_id: uuid.UUID) -> _MissionTopicData:
    recordings = (await db.execute(queries.recordings_in_time(mission_id, actor))).all()
    statement = queries.topics_of_files(mission_id, state.start_ns, state.end_ns, actor)
    topics = await _merged(db, statement, [row.id for row in recordings])
    types: dict[str, list[str | None]] = {}
    for merged in topics:
        types.setdefault(merged.key.name, []).append(merged.key.message_type)
    return _MissionTopicData(
        span=(state.start_ns, state.end_ns),
        bin_ns=max((merged.density.bin_ns for merged in topics if merged.density), default=1),
        recordings=[RecordingRef(id=row.id, name=row.name) for row in recordings],
        topics=topics,
        types=types,
        next=None,
        is_current=True,
    )


def _axis(data: _MissionTopicData, bins: int) -> TimeAxis | None:
    """Return the narrowest axis of at most `bins` bins; its bins are not narrower than the stored ones."""
    start_ns, end_ns = data.span
    if start_ns is None or end_ns is None or not bins:
        return None
    bits = data.bin_ns.bit_length() - 1
    while (end_ns >> bits) - (start_ns >> bits) >= bins:
        bits += 1
    first = start_ns >> bits
    return TimeAxis(start_ns=first << bits, bin_ns=1 << bits, bins=(end_ns >> bits) - first + 1)


def _topic(merged: MergedTopic, types: Sequence[str | None], axis: TimeAxis | None) -> MissionTopic:
    counts = None
    if axis is not None and merged.density is not None:
        counts = on_axis(merged.density, start_ns=axis.start_ns, bin_ns=axis.bin_ns, bins=axis.bins)
    return MissionTopic(
        name=merged.key.name,
        message_type=merged.key.message_type,
        other_types=[other for other in types if other != merged.key.message_type],
        count=merged.count,
        file_count=merged.file_count,
        recording_count=merged.recording_count,
        recordings=list(zip(merged.recording_ranges[::2], merged.recording_ranges[1::2], strict=True)),
        first_ns=merged.first_ns,
        last_ns=merged.last_ns,
        rate_hz=merged.rate_hz,
        longest_gap_ns=merged.longest_gap_ns,
        stored_bytes=merged.stored_bytes,
        counts=counts,
    )


def _values(mission_id: uuid.UUID, merged: MergedTopic) -> dict[str, object]:
    return {
        "mission_id": mission_id,
        "name": merged.key.name,
        "message_type": merged.key.message_type,
        "count": _bigint(merged.count),
        "file_count": merged.file_count,
        "recording_count": merged.recording_count,
        "recording_ranges": merged.recording_ranges,
        "first_ns": merged.first_ns,
        "last_ns": merged.last_ns,
        "rate_hz": merged.rate_hz,
        "longest_gap_ns": merged.longest_gap_ns,
        "stored_bytes": _bigint(merged.stored_bytes),
        "density": pack(merged.density) if merged.density is not None else None,
    }


def _bigint(value: int | None) -> int | None:
    return value if value is None or value <= _MAX_BIGINT else None  # a sum of what files claim


def _from_row(row: Row[Any]) -> MergedTopic:
    density: MessageDensity | None = unpack(row.density) if row.density is not None else None
    return MergedTopic(
        key=TopicKey(row.name, row.message_type),
        count=row.message_count,
        file_count=row.file_count,
        recording_count=row.recording_count,
        recording_ranges=row.recording_ranges,
        first_ns=row.first_ns,
        last_ns=row.last_ns,
        rate_hz=row.rate_hz,
        longest_gap_ns=row.longest_gap_ns,
        stored_bytes=row.stored_bytes,
        density=density,
    )
