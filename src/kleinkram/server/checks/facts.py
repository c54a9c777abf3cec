"""What the tables say about missions, as the checks read it: the same facts as of the files in a folder.

Four statements for any number of missions. Files that a run made from recordings are left out.
"""

import hashlib
import json
import uuid
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, Select, and_, select

from kleinkram.checks.facts import FileFacts, MissionFacts, RecordingFacts, TopicFacts
from kleinkram.contract.metadata import Metadata
from kleinkram.recordings.model import Content, Problem
from kleinkram.server.db import Connection, among
from kleinkram.server.missions.queries import AWAITS_READING
from kleinkram.server.tables import blob, file, mission, mission_topic, mission_topics, project, recording

_Rows = Mapping[uuid.UUID, Sequence[Row[Any]]]


@dataclass(frozen=True)
class JudgedMission:
    """A mission that is about to be judged.

    Attributes:
        facts: None while recordings or topics are not derived from the present files.
        is_reading: some of its files are still to be read.
        metadata: those of the mission.
        recorded_files: SHA-256 in hex by path, of the files that belong to recordings.
        all_files: the same of all files.
    """

    id: uuid.UUID
    project_id: uuid.UUID
    files_revision: int
    checks_number: int
    is_complete: bool
    metadata: Metadata
    facts: MissionFacts | None
    is_reading: bool
    recorded_files: Mapping[str, str]
    all_files: Mapping[str, str]

    @property
    def inputs_sha256(self) -> bytes:
        """Hash of the paths and bytes of all files."""
        return hashlib.sha256(json.dumps(sorted(self.all_files.items())).encode()).digest()


async def read_missions(db: Connection, mission_ids: Sequence[uuid.UUID]) -> list[JudgedMission]:
    """Return missions with their facts, by id; those in the trash are left out."""
    rows = (await db.execute(_missions(mission_ids))).all()
    ids = [row.id for row in rows]
    files = _by_mission((await db.execute(_files(ids))).all())
    recordings = _by_mission((await db.execute(_recordings(ids))).all())
    topics = _by_mission((await db.execute(_topics(ids))).all())
    return [_judged(row, files, recordings, topics) for row in rows]


def _judged(row: Row[Any], files: _Rows, recordings: _Rows, topics: _Rows) -> JudgedMission:
    own = files.get(row.id, ())
    is_derived = row.derived_revision == row.files_revision == row.topics_revision
    facts = _facts(row, own, recordings.get(row.id, ()), topics.get(row.id, ())) if is_derived else None
    hashes = {one.path: one.sha256.hex() for one in own}
    return JudgedMission(
        id=row.id,
        project_id=row.project_id,
        files_revision=row.files_revision,
        checks_number=row.checks_number,
        is_complete=row.completed_at is not None,
        metadata=row.metadata,
        facts=facts,
        is_reading=any(one.awaits_reading for one in own),
        recorded_files={one.path: hashes[one.path] for one in own if one.recording_id is not None},
        all_files=hashes,
    )


def _facts(
    row: Row[Any], files: Sequence[Row[Any]], recordings: Sequence[Row[Any]], topics: Sequence[Row[Any]]
) -> MissionFacts:
    members: dict[uuid.UUID, list[Row[Any]]] = defaultdict(list)
    for one in files:
        if one.recording_id is not None:
            members[one.recording_id].append(one)
    names = {one.id: one.name for one in recordings}
    return MissionFacts(
        files=tuple(
            FileFacts(
                one.path, one.size_bytes, None if one.awaits_reading else Content(one.content), one.content_reason
            )
            for one in files
        ),
        recordings=tuple(_recording(one, members[one.id]) for one in recordings if one.id in members),
        topics=tuple(_topic(one, names, row.recording_ids) for one in topics),
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        metadata=row.metadata,
    )


def _recording(row: Row[Any], members: Sequence[Row[Any]]) -> RecordingFacts:
    """Return a recording with the problems of its files, which its row does not repeat."""
    problems = [problem for one in (*members, row) for problem in one.problems]
    return RecordingFacts(
        name=row.name,
        paths=tuple(one.path for one in members),
        content=Content(row.content),
        reason=row.content_reason,
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        problems=tuple(Problem(**problem) for problem in problems),
    )


def _topic(row: Row[Any], names: Mapping[uuid.UUID, str], recording_ids: Sequence[uuid.UUID]) -> TopicFacts:
    ranges = zip(row.recording_ranges[::2], row.recording_ranges[1::2], strict=True)
    numbers = [number for first, last in ranges for number in range(first, last + 1)]
    return TopicFacts(
        name=row.name,
        message_type=row.message_type,
        count=row.message_count,
        first_ns=row.first_ns,
        last_ns=row.last_ns,
        rate_hz=row.rate_hz,
        longest_gap_ns=row.longest_gap_ns,
        recordings=tuple(names[recording_ids[number]] for number in numbers if recording_ids[number] in names),
    )


def _by_mission(rows: Sequence[Row[Any]]) -> _Rows:
    by_mission: dict[uuid.UUID, list[Row[Any]]] = defaultdict(list)
    for row in rows:
        by_mission[row.mission_id].append(row)
    return by_mission


_STATE = ("id", "project_id", "files_revision", "derived_revision", "completed_at", "start_ns", "end_ns", "metadata")


def _missions(mission_ids: Sequence[uuid.UUID]) -> Select[Any]:
    columns = (*(mission.c[name] for name in _STATE), project.c.checks_number)
    topics = (mission_topics.c.revision.label("topics_revision"), mission_topics.c.recording_ids)
    stmt = select(*columns, *topics).join(project, project.c.id == mission.c.project_id)
    stmt = stmt.outerjoin(mission_topics, mission_topics.c.mission_id == mission.c.id)
    is_live = and_(mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None))
    return stmt.where(among(mission.c.id, mission_ids), is_live).order_by(mission.c.id)


def _files(mission_ids: Sequence[uuid.UUID]) -> Select[Any]:
    known = (blob.c.size_bytes, blob.c.sha256, blob.c.content, blob.c.content_reason, blob.c.problems)
    columns = (file.c.mission_id, file.c.path, file.c.recording_id, *known, AWAITS_READING.label("awaits_reading"))
    stmt = select(*columns).join(blob, blob.c.id == file.c.blob_id)
    recorded = and_(file.c.deleted_at.is_(None), file.c.origin != "run")
    return stmt.where(among(file.c.mission_id, mission_ids), recorded).order_by(file.c.path)


def _recordings(mission_ids: Sequence[uuid.UUID]) -> Select[Any]:
    return select(recording).where(among(recording.c.mission_id, mission_ids)).order_by(recording.c.name)


def _topics(mission_ids: Sequence[uuid.UUID]) -> Select[Any]:
    names = ("mission_id", "name", "message_type", "recording_ranges", "first_ns", "last_ns", "rate_hz")
    columns = (*(mission_topic.c[name] for name in names), mission_topic.c.longest_gap_ns)
    stmt = select(*columns, mission_topic.c.count.label("message_count"))
    return stmt.where(among(mission_topic.c.mission_id, mission_ids)).order_by(mission_topic.c.id)
