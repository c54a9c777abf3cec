"""The topics of a mission: derived by a worker whenever its files change, and answered from there.

Who is shown only some of its files gets those of these files, added up at once; so does everybody as long as nothing
was derived.
"""

import uuid
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, Select, delete, insert

from kleinkram.contract.errors import NotFound
from kleinkram.contract.overviews import MissionTopic, MissionTopics, RecordingRef, TimeAxis
from kleinkram.recordings.density import on_axis, pack, unpack
from kleinkram.recordings.model import MessageDensity
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import Connection
from kleinkram.server.missions import service as missions
from kleinkram.server.overviews import queries
from kleinkram.server.overviews.merge import Key, Merged, merge
from kleinkram.server.pagination import PageRequest, fetch_page
from kleinkram.server.tables import MOST_KEPT_TOPICS, mission_topic

_FETCHED_AT_ONCE = 2_000
_MAX_BIGINT = 2**63 - 1


@dataclass(frozen=True)
class _Found:
    """What is known of a mission's topics: its span, its recordings, and topics of which some may be left for later."""

    span: tuple[int | None, int | None]
    bin_ns: int
    recordings: list[RecordingRef]
    topics: list[Merged]
    types: dict[str, list[str | None]]
    next: str | None
    is_current: bool


async def list_mission_topics(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, bins: int, page: PageRequest
) -> MissionTopics:
    """Return a page of the topics of a mission, with their counts in at most so many bins.

    Raises:
        NotFound: the mission is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    state = (await db.execute(queries.mission_topics_state(actor, mission_id))).one_or_none()
    if state is None:
        raise NotFound(noun="mission", ref=str(mission_id))
    if sees_whole_missions(actor) and state.revision is not None:
        found = await _kept(db, state, mission_id, page)
    else:
        found = await _added_up(db, actor, state, mission_id)
    axis = _axis(found, bins)
    return MissionTopics(
        axis=axis,
        recordings=found.recordings,
        items=[_topic(each, found.types.get(each.key.name, []), axis if bins else None) for each in found.topics],
        next=found.next,
        is_current=found.is_current,
    )


async def keep_topics(db: Connection, mission_id: uuid.UUID) -> None:
    """Derive a mission's topics from its files, and keep them in place of those of an earlier state.

    Reads what may be hundreds of thousands of rows, at once but a few, and locks the mission only to write.
    """
    state = (await db.execute(queries.bare_mission(mission_id))).one_or_none()
    if state is None:
        return
    recordings = (await db.execute(queries.recordings_in_time(mission_id))).all()
    ids = [row.id for row in recordings]
    topics = await _merged(db, queries.topics_of_files(mission_id, state.start_ns, state.end_ns), ids)
    if not await missions.lock_mission(db, mission_id):
        return
    bin_ns = max((each.density.bin_ns for each in topics if each.density), default=1)
    header = {"mission_id": mission_id, "revision": state.files_revision, "recording_ids": ids, "bin_ns": bin_ns}
    if (await db.execute(queries.put_header(**header))).first() is None:
        return
    await db.execute(delete(mission_topic).where(mission_topic.c.mission_id == mission_id))
    if topics:
        await db.execute(insert(mission_topic), [_values(mission_id, each) for each in topics])


async def _merged(db: Connection, statement: Select[Any], recording_ids: Sequence[uuid.UUID]) -> list[Merged]:
    found: list[Merged] = []
    async for each in merge(_streamed(db, statement), recording_ids):
        found.append(each)
        if len(found) == MOST_KEPT_TOPICS:
            break
    return found


async def _streamed(db: Connection, statement: Select[Any]) -> AsyncIterator[Row[Any]]:
    result = await db.stream(statement.execution_options(yield_per=_FETCHED_AT_ONCE))
    try:
        async for rows in result.partitions():
            for row in rows:
                yield row
    finally:
        await result.close()


async def _kept(db: Connection, state: Row[Any], mission_id: uuid.UUID, page: PageRequest) -> _Found:
    rows = await fetch_page(db, queries.kept_topics(mission_id), queries.KEPT_ORDER, page)
    recordings = (await db.execute(queries.recordings_by_id(mission_id))).all()
    return _Found(
        span=(state.start_ns, state.end_ns),
        bin_ns=state.bin_ns,
        recordings=[RecordingRef(id=row.id, name=row.name or "") for row in recordings],
        topics=[_from_row(row) for row in rows.items],
        types={row.name: row.types for row in rows.items},
        next=rows.next,
        is_current=state.revision == state.files_revision,
    )


async def _added_up(db: Connection, actor: Actor, state: Row[Any], mission_id: uuid.UUID) -> _Found:
    recordings = (await db.execute(queries.recordings_in_time(mission_id, actor))).all()
    statement = queries.topics_of_files(mission_id, state.start_ns, state.end_ns, actor)
    topics = await _merged(db, statement, [row.id for row in recordings])
    types: dict[str, list[str | None]] = {}
    for each in topics:
        types.setdefault(each.key.name, []).append(each.key.message_type)
    return _Found(
        span=(state.start_ns, state.end_ns),
        bin_ns=max((each.density.bin_ns for each in topics if each.density), default=1),
        recordings=[RecordingRef(id=row.id, name=row.name) for row in recordings],
        topics=topics,
        types=types,
        next=None,
        is_current=True,
    )


def _axis(found: _Found, bins: int) -> TimeAxis | None:
    """Return the narrowest bins that are few enough, and not narrower than those that are known."""
    start_ns, end_ns = found.span
    if start_ns is None or end_ns is None or not bins:
        return None
    bits = found.bin_ns.bit_length() - 1
    while (end_ns >> bits) - (start_ns >> bits) >= bins:
        bits += 1
    first = start_ns >> bits
    return TimeAxis(start_ns=first << bits, bin_ns=1 << bits, bins=(end_ns >> bits) - first + 1)


def _topic(each: Merged, types: Sequence[str | None], axis: TimeAxis | None) -> MissionTopic:
    counts = None
    if axis is not None and each.density is not None:
        counts = on_axis(each.density, start_ns=axis.start_ns, bin_ns=axis.bin_ns, bins=axis.bins)
    return MissionTopic(
        name=each.key.name,
        message_type=each.key.message_type,
        other_types=[other for other in types if other != each.key.message_type],
        count=each.count,
        file_count=each.file_count,
        recording_count=each.recording_count,
        recordings=list(zip(each.places[::2], each.places[1::2], strict=True)),
        first_ns=each.first_ns,
        last_ns=each.last_ns,
        rate_hz=each.rate_hz,
        longest_gap_ns=each.longest_gap_ns,
        stored_bytes=each.stored_bytes,
        counts=counts,
    )


def _values(mission_id: uuid.UUID, each: Merged) -> dict[str, object]:
    return {
        "mission_id": mission_id,
        "name": each.key.name,
        "message_type": each.key.message_type,
        "count": _bigint(each.count),
        "file_count": each.file_count,
        "recording_count": each.recording_count,
        "places": each.places,
        "first_ns": each.first_ns,
        "last_ns": each.last_ns,
        "rate_hz": each.rate_hz,
        "longest_gap_ns": each.longest_gap_ns,
        "stored_bytes": _bigint(each.stored_bytes),
        "density": pack(each.density) if each.density is not None else None,
    }


def _bigint(value: int | None) -> int | None:
    return value if value is None or value <= _MAX_BIGINT else None  # a sum of what files claim


def _from_row(row: Row[Any]) -> Merged:
    density: MessageDensity | None = unpack(row.density) if row.density is not None else None
    return Merged(
        key=Key(row.name, row.message_type),
        count=row.message_count,
        file_count=row.file_count,
        recording_count=row.recording_count,
        places=row.places,
        first_ns=row.first_ns,
        last_ns=row.last_ns,
        rate_hz=row.rate_hz,
        longest_gap_ns=row.longest_gap_ns,
        stored_bytes=row.stored_bytes,
        density=density,
    )
