"""How the files of a mission become recordings: the request, the derivation, and the rows.

Every change of files requests that the mission's recordings are derived again, and its span and totals from these. The
job (`overviews/jobs.py`) reads the files, derives, and stores what differs.
"""

import datetime
import uuid
from collections import defaultdict
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import PurePosixPath
from typing import Any, NamedTuple

from sqlalchemy import ARRAY, Integer, Text, Uuid, bindparam, cast, column, delete, func, literal, select, text, update
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
from kleinkram.server.jobs.queue import Job, Priority, enqueue, has_job
from kleinkram.server.missions.queries import store_totals
from kleinkram.server.tables import DERIVED_ORIGIN, blob, file, mission, mission_topics, recording, topic

_WAITING = text(
    "SELECT 1 FROM procrastinate_jobs WHERE task_name = :task AND status = 'todo' AND args ->> 'ref' = :ref LIMIT 1"
)
_INSERT_BATCH = 1000
_MAX_BIGINT = 2**63 - 1
# 1990: earlier times, such as 1970, are of clocks that were never set.
_CREDIBLE_NS = 631_152_000 * 10**9
# Of one recording, about 100 MB. Topics of recordings with more are not compared.
_MAX_TOPICS = 100_000
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
# A recording is identified by these within its mission.
_KEY = ("name", "kind", "is_derived")

Topics = Mapping[uuid.UUID, Sequence[TopicSummary]]
# The content of each metadata.yaml by its path: None where it is invalid, no entry where it was not read.
MetadataFiles = Mapping[str, Rosbag2Metadata | None]


# -- requesting -------------------------------------------------------------------------------------------------------


async def derive_again(db: Connection, mission_id: uuid.UUID) -> None:
    """Have a mission's recordings derived again after this transaction.

    A queued job suffices. It cannot miss this change, because it begins by acquiring the lock on the mission that this
    transaction holds.
    """
    changed = update(mission).where(mission.c.id == mission_id).values(files_revision=mission.c.files_revision + 1)
    await db.execute(changed)
    if not await awaits_derivation(db, mission_id):
        await enqueue(db, Job.derive_recordings, ids=[str(mission_id)], priority=Priority.high)


async def derive_again_later(db: Connection, mission_id: uuid.UUID, later: datetime.timedelta) -> None:
    """Have a mission's recordings derived after a delay, together with later changes."""
    if not await awaits_derivation(db, mission_id):
        await enqueue(db, Job.derive_recordings, ids=[str(mission_id)], priority=Priority.high, later=later)


async def awaits_derivation(db: Connection, mission_id: uuid.UUID) -> bool:
    """Return whether a job that derives a mission's recordings is queued."""
    waiting = await db.execute(_WAITING, {"task": Job.derive_recordings.value, "ref": str(mission_id)})
    return waiting.first() is not None


async def derive_forgotten(db: Connection, *, limit: int) -> None:
    """Enqueue jobs for missions whose recordings or topics are outdated, and that have no queued or running job."""
    current = select(mission_topics.c.mission_id).where(mission_topics.c.revision == mission.c.files_revision)
    stale = select(cast(mission.c.id, Text)).where(
        (mission.c.derived_revision != mission.c.files_revision)
        | ((mission.c.files_revision > 0) & ~current.where(mission_topics.c.mission_id == mission.c.id).exists()),
        ~has_job(Job.derive_recordings, mission.c.id),
    )
    ids = (await db.execute(stale.limit(limit))).scalars().all()
    await enqueue(db, Job.derive_recordings, ids=ids, priority=Priority.normal)


# -- deriving ---------------------------------------------------------------------------------------------------------


class LiveFile(NamedTuple):
    """A file of a mission that is not in the trash, with what is known of its content."""

    id: uuid.UUID
    path: str
    blob_id: uuid.UUID
    recording_id: uuid.UUID | None
    key: str
    size_bytes: int
    start_ns: int | None
    end_ns: int | None
    message_count: int | None
    format: str | None
    content: str
    content_reason: str | None
    lost: dict[str, int] | None
    depth: str | None
    uploaded_by_id: uuid.UUID
    is_derived: bool


@dataclass(frozen=True)
class Derived:
    """One recording as it follows from its files."""

    group: RecordingGroup
    values: dict[str, Any]

    @property
    def key(self) -> tuple[str, str, bool]:
        """Name, kind, and whether it is derived: a mission has each recording once by these."""
        return self.group.name, self.group.kind.value, self.values["is_derived"]


async def live_files(db: Connection, mission_id: uuid.UUID, *, named: str = "") -> list[LiveFile]:
    """Return the files of a mission; with `named`, only those whose paths end in it."""
    own = ("id", "path", "blob_id", "recording_id")
    of_blob = (blob.c[name] for name in LiveFile._fields[:-1] if name not in own)
    statement = (
        select(*(file.c[name] for name in own), *of_blob, file.c.origin == DERIVED_ORIGIN)
        .join(blob, blob.c.id == file.c.blob_id)
        .where(file.c.mission_id == mission_id, file.c.deleted_at.is_(None))
    )
    if named:
        statement = statement.where(file.c.path.endswith(named, autoescape=True))
    return [LiveFile._make(row) for row in await db.execute(statement)]


async def derive(db: Connection, files: Sequence[LiveFile], metadata_files: MetadataFiles) -> list[Derived]:
    """Group files into recordings, and combine their summaries as `klein inspect` does for the files of a folder.

    Derived files form recordings of their own. One query for any number of files; holds the topics of one recording at
    a time.
    """
    by_path = {one.path: one for one in files}
    parsed_files = {path: parsed for path, parsed in metadata_files.items() if parsed is not None}
    groups = []
    for is_derived in (False, True):
        paths = [one.path for one in files if one.is_derived is is_derived]
        groups += group(paths, {path: parsed_files[path] for path in paths if path in parsed_files})
    members = [[by_path[path] for path in grouped.members] for grouped in groups]
    # The topics of a single file need no comparison, unless there is a metadata.yaml.
    with_topics = [
        own if len(own) > 1 or grouped.metadata_path in metadata_files else []
        for grouped, own in zip(groups, members, strict=True)
    ]
    derived: list[Derived] = []
    async for topics in _topics(db, [{one.blob_id for one in own} for own in with_topics]):
        grouped, own = groups[len(derived)], members[len(derived)]
        parsed = metadata_files.get(grouped.metadata_path or "")
        values = _values(grouped, parsed, _combined(grouped, own, metadata_files, topics))
        is_derived = any(by_path[path].is_derived for path in _paths(grouped))
        derived.append(Derived(grouped, {**values, "is_derived": is_derived}))
    return derived


# Fields of a `TopicSummary` after its name, in order.
_TOPIC_TEXTS = ("message_type", "schema_name", "schema_encoding", "message_encoding")
_TOPIC_NUMBERS = ("count", "first_ns", "last_ns", "rate_hz", "longest_gap_ns", "head_gap_ns", "tail_gap_ns")


async def _topics(db: Connection, blob_sets: Sequence[set[uuid.UUID]]) -> AsyncIterator[Topics]:
    """Yield the topics of each set of blobs; none where they are too many."""
    pairs = [(number, blob_id) for number, ids in enumerate(blob_sets) for blob_id in ids]
    wanted_blobs = func.unnest(
        literal([number for number, _ in pairs], ARRAY(Integer)),
        literal([blob_id for _, blob_id in pairs], ARRAY(Uuid)),
    ).table_valued(column("number", Integer), column("blob_id", Uuid), name="given")
    wanted_blobs = wanted_blobs.render_derived()
    texts = (func.coalesce(topic.c[name], "") for name in _TOPIC_TEXTS)
    columns = (topic.c.blob_id, topic.c.name, *texts, *(topic.c[name] for name in _TOPIC_NUMBERS))
    statement = select(wanted_blobs.c.number, *columns).join(topic, topic.c.blob_id == wanted_blobs.c.blob_id)
    result = await db.stream(statement.order_by(wanted_blobs.c.number, topic.c.blob_id, topic.c.name))
    row = await result.fetchone()
    for number in range(len(blob_sets)):
        topics_by_blob: dict[uuid.UUID, list[TopicSummary]] = defaultdict(list)
        count = 0
        while row is not None and row.number == number:
            count += 1
            if count <= _MAX_TOPICS:
                topics_by_blob[row.blob_id].append(TopicSummary(*row[2:]))
            row = await result.fetchone()
        yield topics_by_blob if count <= _MAX_TOPICS else {}
    await result.close()


def _combined(
    grouped: RecordingGroup, members: Sequence[LiveFile], metadata_files: MetadataFiles, topics: Topics
) -> RecordingSummary:
    names = [PurePosixPath(path).name for path in grouped.members]
    summaries = [_summary(one, topics.get(one.blob_id, ())) for one in members]
    if grouped.kind is not RecordingGroupKind.rosbag2:
        return combine(summaries, names)
    path = grouped.metadata_path or ""
    if path in metadata_files:
        return combine_folder(metadata_files[path], names, summaries)
    summary = combine(summaries, names)
    why = "it is larger than 256 KiB or takes too long to read, or the store has lost it"
    message = f"it was not compared with the files: {why}"
    return replace(summary, problems=(Problem("metadata-unread", "metadata.yaml", message), *summary.problems))


def _summary(one: LiveFile, topics: Sequence[TopicSummary]) -> RecordingSummary:
    """Return the summary of one file, without the problems, which stay with the file."""
    return RecordingSummary(
        format=RecordingFormat(one.format) if one.format else RecordingFormat.unknown,
        content=Content(one.content),
        reason=one.content_reason,
        message_count=one.message_count,
        start_ns=one.start_ns,
        end_ns=one.end_ns,
        topics=tuple(topics),
        depth=Depth(one.depth) if one.depth else Depth.summary,
        lost=Lost(**one.lost) if one.lost else None,
    )


def _values(grouped: RecordingGroup, parsed: Rosbag2Metadata | None, summary: RecordingSummary) -> dict[str, Any]:
    count = summary.message_count
    # Dictionaries as ordered sets.
    present = dict.fromkeys(PurePosixPath(path).name for path in grouped.members)
    named = dict.fromkeys(PurePosixPath(path).name for path in parsed.files) if parsed else present
    return {
        "name": grouped.name,
        "kind": grouped.kind.value,
        "missing": [fit_text(name) for name in named if name not in present],
        "unlisted": [fit_text(name) for name in present if name not in named],
        "problems": [{key: fit_text(value) for key, value in asdict(one).items()} for one in summary.problems],
        "message_count": count if count is not None and count <= _MAX_BIGINT else None,
        "start_ns": summary.start_ns,
        "end_ns": summary.end_ns,
        "content": summary.content.value,
        "content_reason": fit_text(summary.reason),
        "lost": summary.lost and asdict(summary.lost),
    }


# -- storing ----------------------------------------------------------------------------------------------------------


async def store(db: Connection, mission_id: uuid.UUID, derived: Sequence[Derived], files: Sequence[LiveFile]) -> None:
    """Store the derived recordings and span of a mission; recordings that continue to exist keep their ids.

    Only changes are written: of ten thousand recordings, one changes with each file that is read.
    """
    stored = await _stored_recordings(db, mission_id)
    ids = {key: recording_id for key, (recording_id, _) in stored.items()}
    new = [
        item for item in derived if item.key not in stored or stored[item.key][1] != [*map(item.values.get, _DERIVED)]
    ]
    for start in range(0, len(new), _INSERT_BATCH):
        ids |= await _upsert(db, mission_id, new[start : start + _INSERT_BATCH])
    ids = {item.key: ids[item.key] for item in derived}
    gone = delete(recording).where(recording.c.mission_id == mission_id, recording.c.id.not_in(list(ids.values())))
    await db.execute(gone)
    owner = {path: ids[item.key] for item in derived for path in _paths(item.group)}
    moved = [one for one in files if one.recording_id != owner.get(one.path)]
    links = [{"b_file": one.id, "b_recording": owner.get(one.path)} for one in moved]
    if links:
        statement = update(file).where(file.c.id == bindparam("b_file"))
        await db.execute(statement.values(recording_id=bindparam("b_recording")), links)
    start_ns, end_ns = _span(derived)
    derived_revision = mission.c.files_revision
    await db.execute(store_totals(mission_id, start_ns=start_ns, end_ns=end_ns, derived_revision=derived_revision))
    await publish(db, [ChangeEvent("recording", ChangeKind.changed, mission_id=mission_id)])


def _span(derived: Sequence[Derived]) -> tuple[int | None, int | None]:
    """Return start and end of what was recorded, without recordings whose clock was never set if there are others."""
    spans = [
        (item.values["start_ns"], item.values["end_ns"])
        for item in derived
        if item.values["start_ns"] is not None and not item.values["is_derived"]
    ]
    credible = [span for span in spans if span[0] >= _CREDIBLE_NS] or spans
    return min((start for start, _ in credible), default=None), max((end for _, end in credible), default=None)


def _paths(grouped: RecordingGroup) -> list[str]:
    return [*grouped.members, *([grouped.metadata_path] if grouped.metadata_path else [])]


async def _stored_recordings(
    db: Connection, mission_id: uuid.UUID
) -> dict[tuple[str, str, bool], tuple[uuid.UUID, list[object]]]:
    """Return id and derived values of each recording of a mission, by its key."""
    columns = (recording.c[name] for name in (*_KEY, "id", *_DERIVED))
    rows = await db.execute(select(*columns).where(recording.c.mission_id == mission_id))
    return {(name, kind, is_derived): (found_id, values) for name, kind, is_derived, found_id, *values in rows}


async def _upsert(
    db: Connection, mission_id: uuid.UUID, derived: Sequence[Derived]
) -> dict[tuple[str, str, bool], uuid.UUID]:
    values = [{"id": uuid.uuid4(), "mission_id": mission_id, **item.values} for item in derived]
    statement = upsert(recording).values(values)
    changed = {column: statement.excluded[column] for column in _DERIVED}
    statement = statement.on_conflict_do_update(index_elements=["mission_id", *_KEY], set_=changed)
    rows = await db.execute(statement.returning(recording.c.id, *(recording.c[name] for name in _KEY)))
    return {(row.name, row.kind, row.is_derived): row.id for row in rows}
