"""From the files of a mission to its recordings: which belong together, what is missing, what they span."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from sqlalchemy import Row, bindparam, delete, select, update
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.recordings import RecordingGroup, Rosbag2Metadata, group
from kleinkram.server.blobs.fitting import fit
from kleinkram.server.db import Connection
from kleinkram.server.tables import blob, file, mission, recording

_INSERT_BATCH = 1000
# 1990: no robot recorded before; a clock that starts in 1970 was never set.
_MAX_BIGINT = 2**63 - 1
_CREDIBLE_NS = 631_152_000 * 10**9


@dataclass(frozen=True)
class Derived:
    """One recording as it follows from its files."""

    group: RecordingGroup
    values: dict[str, Any]


async def live_files(db: Connection, mission_id: uuid.UUID) -> Sequence[Row[Any]]:
    """Return path and content facts of a mission's files."""
    statement = (
        select(
            file.c.id,
            file.c.path,
            blob.c.key,
            blob.c.size_bytes,
            blob.c.start_ns,
            blob.c.end_ns,
            blob.c.message_count,
        )
        .join(blob, blob.c.id == file.c.blob_id)
        .where(file.c.mission_id == mission_id, file.c.deleted_at.is_(None))
    )
    return (await db.execute(statement)).all()


def derive(rows: Sequence[Row[Any]], stated: Mapping[str, Rosbag2Metadata]) -> list[Derived]:
    """Group files into recordings. `stated` holds what each readable metadata.yaml says, by its path."""
    by_path = {row.path: row for row in rows}
    return [_derive_one(each, by_path, stated.get(each.metadata_path or "")) for each in group(by_path)]


def _derive_one(each: RecordingGroup, by_path: Mapping[str, Row[Any]], stated: Rosbag2Metadata | None) -> Derived:
    members = [by_path[path] for path in each.members]
    spans = [(row.start_ns, row.end_ns) for row in members if row.start_ns is not None]
    counts = [row.message_count for row in members]
    count = sum(counts) if None not in counts else None
    values: dict[str, Any] = {
        "name": each.name,
        "kind": each.kind.value,
        "start_ns": min((start for start, _ in spans), default=None),
        "end_ns": max((end for _, end in spans), default=None),
        "message_count": count if count is not None and count <= _MAX_BIGINT else None,
        "missing": [],
        "surplus": [],
        "problems": [],
    }
    return Derived(each, values | (_compared(each, stated, count) if stated else {}))


def _compared(each: RecordingGroup, stated: Rosbag2Metadata, count: int | None) -> dict[str, Any]:
    here = {PurePosixPath(path).name for path in each.members}
    named = [fit(PurePosixPath(path).name) for path in stated.files]
    missing = [name for name in named if name not in here]
    problems = []
    if missing:
        message = f"metadata.yaml names {', '.join(missing)}, which this mission does not have; upload what is missing"
        problems.append({"code": "member-missing", "where": each.name, "message": message})
    elif None not in (count, stated.message_count) and count != stated.message_count:
        message = f"metadata.yaml claims {stated.message_count} messages, the files hold {count}"
        problems.append({"code": "metadata-count", "where": each.name, "message": message})
    return {"missing": missing, "surplus": sorted(here - set(named)), "problems": problems}


async def keep(db: Connection, mission_id: uuid.UUID, derived: Sequence[Derived], rows: Sequence[Row[Any]]) -> None:
    """Make a mission's recordings and span those derived; recordings that stay keep their ids."""
    ids: dict[tuple[str, str], uuid.UUID] = {}
    for start in range(0, len(derived), _INSERT_BATCH):
        ids |= await _upsert(db, mission_id, derived[start : start + _INSERT_BATCH])
    gone = delete(recording).where(recording.c.mission_id == mission_id, recording.c.id.not_in(list(ids.values())))
    await db.execute(gone)
    owner = {path: ids[each.group.name, each.group.kind.value] for each in derived for path in _paths(each.group)}
    links = [{"b_file": row.id, "b_recording": owner.get(row.path)} for row in rows]
    if links:
        statement = update(file).where(
            file.c.id == bindparam("b_file"), file.c.recording_id.is_distinct_from(bindparam("b_recording"))
        )
        await db.execute(statement.values(recording_id=bindparam("b_recording")), links)
    start_ns, end_ns = _span(derived)
    await db.execute(
        update(mission)
        .where(mission.c.id == mission_id)
        .values(start_ns=start_ns, end_ns=end_ns, derived_revision=mission.c.files_revision)
    )


def _span(derived: Sequence[Derived]) -> tuple[int | None, int | None]:
    """Return from when to when a mission's recordings last. One from a clock that was never set does not stretch it."""
    spans = [
        (each.values["start_ns"], each.values["end_ns"]) for each in derived if each.values["start_ns"] is not None
    ]
    credible = [span for span in spans if span[0] >= _CREDIBLE_NS] or spans
    return min((start for start, _ in credible), default=None), max((end for _, end in credible), default=None)


def _paths(each: RecordingGroup) -> list[str]:
    return [*each.members, *([each.metadata_path] if each.metadata_path else [])]


async def _upsert(
    db: Connection, mission_id: uuid.UUID, derived: Sequence[Derived]
) -> dict[tuple[str, str], uuid.UUID]:
    values = [{"id": uuid.uuid4(), "mission_id": mission_id, **each.values} for each in derived]
    statement = upsert(recording).values(values)
    changed = {
        column: statement.excluded[column]
        for column in ("missing", "surplus", "problems", "message_count", "start_ns", "end_ns")
    }
    statement = statement.on_conflict_do_update(index_elements=["mission_id", "name", "kind"], set_=changed)
    found = await db.execute(statement.returning(recording.c.id, recording.c.name, recording.c.kind))
    return {(row.name, row.kind): row.id for row in found}
