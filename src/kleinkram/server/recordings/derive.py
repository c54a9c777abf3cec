"""Derives the recordings of a mission from its files, and the mission's span and numbers from these."""

import uuid
from collections import defaultdict
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import PurePosixPath
from typing import Any

from sqlalchemy import ARRAY, Integer, Row, Uuid, bindparam, column, delete, func, literal, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.audit import ChangeKind
from kleinkram.recordings import (
    Content,
    Depth,
    Lost,
    Problem,
    RecordingFormat,
    RecordingGroup,
    RecordingGroupKind,
    RecordingSummary,
    TopicSummary,
    combine,
    group,
)
from kleinkram.recordings.combine_summaries import combine_folder
from kleinkram.recordings.formats.rosbag2.metadata import Rosbag2Metadata
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, fit_text
from kleinkram.server.missions import amounts
from kleinkram.server.tables import blob, file, mission, recording, topic

_INSERT_BATCH = 1000
_MAX_BIGINT = 2**63 - 1
# 1990: no robot recorded before; a clock that starts in 1970 was never set.
_CREDIBLE_NS = 631_152_000 * 10**9
# Of one recording; about 100 MB. Its topics are not compared where it has more.
_MOST_TOPICS = 100_000
_DERIVED = (
    "missing",
    "unlisted",
    "problems",
    "message_count",
    "start_ns",
    "end_ns",
    "content",
    "content_reason",
    "lost",
)

Topics = Mapping[uuid.UUID, Sequence[TopicSummary]]
# What each metadata.yaml says, by its path: None where it is none. Without an entry: it was not looked at.
Stated = Mapping[str, Rosbag2Metadata | None]


@dataclass(frozen=True)
class Derived:
    """One recording as it follows from its files."""

    group: RecordingGroup
    values: dict[str, Any]

    @property
    def key(self) -> tuple[str, str]:
        """Name and kind, by which a mission has each recording once."""
        return self.group.name, self.group.kind.value


async def live_files(db: Connection, mission_id: uuid.UUID, *, named: str = "") -> Sequence[Row[Any]]:
    """Return path and content facts of a mission's files; of those alone whose paths end in a name, if it is given."""
    known = (blob.c.key, blob.c.size_bytes, blob.c.start_ns, blob.c.end_ns, blob.c.message_count, blob.c.format)
    state = (blob.c.content, blob.c.content_reason, blob.c.lost, blob.c.depth, blob.c.uploaded_by_id)
    statement = (
        select(file.c.id, file.c.path, file.c.blob_id, file.c.recording_id, *known, *state)
        .join(blob, blob.c.id == file.c.blob_id)
        .where(file.c.mission_id == mission_id, file.c.deleted_at.is_(None))
    )
    if named:
        statement = statement.where(file.c.path.endswith(named, autoescape=True))
    return (await db.execute(statement)).all()


async def derive(db: Connection, rows: Sequence[Row[Any]], stated: Stated) -> list[Derived]:
    """Group files into recordings, and say of each what `klein inspect` says of the same files in a folder.

    One query, whatever the number of files; holds the topics of one recording at a time.
    """
    by_path = {row.path: row for row in rows}
    groups = group(by_path, {path: parsed for path, parsed in stated.items() if parsed is not None})
    members = [[by_path[path] for path in grouped.members] for grouped in groups]
    # What one file says of its topics, nothing contradicts, unless there is a metadata.yaml.
    with_topics = [
        own if len(own) > 1 or grouped.metadata_path in stated else []
        for grouped, own in zip(groups, members, strict=True)
    ]
    derived: list[Derived] = []
    async for topics in _topics(db, [{row.blob_id for row in own} for own in with_topics]):
        grouped, own = groups[len(derived)], members[len(derived)]
        parsed = stated.get(grouped.metadata_path or "")
        derived.append(
            Derived(
                grouped,
                _values(grouped, parsed, _combined(grouped, own, stated, topics)),
            )
        )
    return derived


async def _topics(db: Connection, blob_sets: Sequence[set[uuid.UUID]]) -> AsyncIterator[Topics]:
    """Yield the topics of each set of blobs, in turn; none where they are too many."""
    pairs = [(number, blob_id) for number, ids in enumerate(blob_sets) for blob_id in ids]
    wanted_blobs = func.unnest(
        literal([number for number, _ in pairs], ARRAY(Integer)),
        literal([blob_id for _, blob_id in pairs], ARRAY(Uuid)),
    ).table_valued(column("number", Integer), column("blob_id", Uuid), name="given")
    wanted_blobs = wanted_blobs.render_derived()
    counted = topic.c.count.label("message_count")
    columns = [column for column in topic.c if column.name != "density"]
    statement = select(wanted_blobs.c.number, *columns, counted).join(topic, topic.c.blob_id == wanted_blobs.c.blob_id)
    result = await db.stream(statement.order_by(wanted_blobs.c.number, topic.c.blob_id, topic.c.name))
    row = await result.fetchone()
    for number in range(len(blob_sets)):
        topics_by_blob: dict[uuid.UUID, list[TopicSummary]] = defaultdict(list)
        count = 0
        while row is not None and row.number == number:
            count += 1
            if count <= _MOST_TOPICS:
                topics_by_blob[row.blob_id].append(_topic(row))
            row = await result.fetchone()
        yield topics_by_blob if count <= _MOST_TOPICS else {}
    await result.close()


def _topic(row: Row[Any]) -> TopicSummary:
    return TopicSummary(
        name=row.name,
        message_type=row.message_type or "",
        schema_name=row.schema_name or "",
        schema_encoding=row.schema_encoding or "",
        message_encoding=row.message_encoding or "",
        count=row.message_count,
        first_ns=row.first_ns,
        last_ns=row.last_ns,
        rate_hz=row.rate_hz,
        longest_gap_ns=row.longest_gap_ns,
        head_gap_ns=row.head_gap_ns,
        tail_gap_ns=row.tail_gap_ns,
    )


def _combined(grouped: RecordingGroup, members: Sequence[Row[Any]], stated: Stated, topics: Topics) -> RecordingSummary:
    names = [PurePosixPath(path).name for path in grouped.members]
    summaries = [_summary(row, topics.get(row.blob_id, ())) for row in members]
    if grouped.kind is not RecordingGroupKind.rosbag2:
        return combine(summaries, names)
    path = grouped.metadata_path or ""
    if path in stated:
        return combine_folder(stated[path], names, summaries)
    summary = combine(summaries, names)
    why = "it is larger than 256 KiB or takes too long to read, or the store has lost it"
    message = f"it was not compared with the files: {why}"
    return replace(summary, problems=(Problem("metadata-unread", "metadata.yaml", message), *summary.problems))


def _summary(row: Row[Any], topics: Sequence[TopicSummary]) -> RecordingSummary:
    """Return what is known of one file. What is odd inside it, its own row says."""
    return RecordingSummary(
        format=RecordingFormat(row.format) if row.format else RecordingFormat.unknown,
        content=Content(row.content),
        reason=row.content_reason,
        message_count=row.message_count,
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        topics=tuple(topics),
        depth=Depth(row.depth) if row.depth else Depth.summary,
        lost=Lost(**row.lost) if row.lost else None,
    )


def _values(grouped: RecordingGroup, parsed: Rosbag2Metadata | None, summary: RecordingSummary) -> dict[str, Any]:
    count = summary.message_count
    # As dictionaries: in order, and quick to look into.
    here = dict.fromkeys(PurePosixPath(path).name for path in grouped.members)
    named = dict.fromkeys(PurePosixPath(path).name for path in parsed.files) if parsed else here
    return {
        "name": grouped.name,
        "kind": grouped.kind.value,
        "missing": [fit_text(name) for name in named if name not in here],
        "unlisted": [fit_text(name) for name in here if name not in named],
        "problems": [{key: fit_text(value) for key, value in asdict(one).items()} for one in summary.problems],
        "message_count": count if count is not None and count <= _MAX_BIGINT else None,
        "start_ns": summary.start_ns,
        "end_ns": summary.end_ns,
        "content": summary.content.value,
        "content_reason": fit_text(summary.reason),
        "lost": summary.lost and asdict(summary.lost),
    }


async def keep(db: Connection, mission_id: uuid.UUID, derived: Sequence[Derived], rows: Sequence[Row[Any]]) -> None:
    """Make a mission's recordings and span those derived; recordings that stay keep their ids.

    Only what changed is written: of ten thousand recordings, one does with each file that is read.
    """
    stored = await _stored_recordings(db, mission_id)
    ids = {key: row.id for key, row in stored.items()}
    new = [item for item in derived if not _is_unchanged(item, stored.get(item.key))]
    for start in range(0, len(new), _INSERT_BATCH):
        ids |= await _upsert(db, mission_id, new[start : start + _INSERT_BATCH])
    ids = {item.key: ids[item.key] for item in derived}
    gone = delete(recording).where(recording.c.mission_id == mission_id, recording.c.id.not_in(list(ids.values())))
    await db.execute(gone)
    owner = {path: ids[item.key] for item in derived for path in _paths(item.group)}
    moved = [row for row in rows if row.recording_id != owner.get(row.path)]
    links = [{"b_file": row.id, "b_recording": owner.get(row.path)} for row in moved]
    if links:
        statement = update(file).where(file.c.id == bindparam("b_file"))
        await db.execute(statement.values(recording_id=bindparam("b_recording")), links)
    start_ns, end_ns = _span(derived)
    derived_revision = mission.c.files_revision
    await db.execute(amounts.keep(mission_id, start_ns=start_ns, end_ns=end_ns, derived_revision=derived_revision))
    await publish(db, [ChangeEvent("recording", ChangeKind.changed, mission_id=mission_id)])


def _span(derived: Sequence[Derived]) -> tuple[int | None, int | None]:
    """Return from when to when a mission's recordings last. One from a clock that was never set does not stretch it."""
    spans = [
        (item.values["start_ns"], item.values["end_ns"]) for item in derived if item.values["start_ns"] is not None
    ]
    credible = [span for span in spans if span[0] >= _CREDIBLE_NS] or spans
    return min((start for start, _ in credible), default=None), max((end for _, end in credible), default=None)


def _paths(grouped: RecordingGroup) -> list[str]:
    return [*grouped.members, *([grouped.metadata_path] if grouped.metadata_path else [])]


async def _stored_recordings(db: Connection, mission_id: uuid.UUID) -> dict[tuple[str, str], Row[Any]]:
    columns = (recording.c[name] for name in ("id", "name", "kind", *_DERIVED))
    rows = await db.execute(select(*columns).where(recording.c.mission_id == mission_id))
    return {(row.name, row.kind): row for row in rows}


def _is_unchanged(item: Derived, row: Row[Any] | None) -> bool:
    return row is not None and all(row._mapping[name] == item.values[name] for name in _DERIVED)


async def _upsert(
    db: Connection, mission_id: uuid.UUID, derived: Sequence[Derived]
) -> dict[tuple[str, str], uuid.UUID]:
    values = [{"id": uuid.uuid4(), "mission_id": mission_id, **item.values} for item in derived]
    statement = upsert(recording).values(values)
    changed = {column: statement.excluded[column] for column in _DERIVED}
    statement = statement.on_conflict_do_update(index_elements=["mission_id", "name", "kind"], set_=changed)
    rows = await db.execute(statement.returning(recording.c.id, recording.c.name, recording.c.kind))
    return {(row.name, row.kind): row.id for row in rows}
