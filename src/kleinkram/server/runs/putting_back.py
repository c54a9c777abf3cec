"""Making files of a mission out of what a run left, in the name of whoever started it and by their rights now."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Row, insert, update

from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.files import ContentState
from kleinkram.contract.names import name_key
from kleinkram.contract.reports import PutBack
from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import find_person
from kleinkram.server.audit.service import Event, record_all
from kleinkram.server.blobs.service import examine_blobs
from kleinkram.server.db import Connection
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.missions import service as missions
from kleinkram.server.quotas.service import Amount, require_room
from kleinkram.server.recordings.service import regroup
from kleinkram.server.tables import blob, file, run_artifact


async def put_back(
    db: Connection, row: Row[Any], wanted: Sequence[PutBack], artifacts: Mapping[str, Row[Any]]
) -> list[str]:
    """Make files of artifacts of a run that is held; return, as sentences, why some could not be made.

    Nothing that is in the mission already is changed.
    """
    wanted = [each for each in wanted if each.path in artifacts]
    if not wanted:
        return []
    most = Right(row.definition["right"])
    starter = await find_person(db, row.started_by_id)
    if starter is None or most.level < Right.create.level:
        return ["It put files back, which takes an action that declares `right: CREATE`; they stay artifacts."]
    actor = replace(starter.asking("begin_uploads", request_id=None, address=None), most=most)
    try:
        await missions.lock_mission_to_fill(db, actor, row.mission_id)
        size_bytes = sum(artifacts[each.path].size_bytes for each in wanted)
        asked = Amount(len(wanted), size_bytes)
        await require_room(db, actor, project_id=row.project_id, asked=asked)
    except KleinkramError as error:
        return [f"What it put back stays among the artifacts: {error}"]
    problems, made = await _make_all(db, row, wanted, artifacts)
    if made:
        name = row.definition["name"]
        events = [
            Event(
                "file.put_back",
                "file",
                file_id,
                path,
                row.project_id,
                after={"run_id": str(row.id), "action": name},
                mission_id=row.mission_id,
            )
            for path, file_id in made.items()
        ]
        await record_all(db, actor, events)
        await regroup(db, row.mission_id)
    return problems


async def _make_all(
    db: Connection, row: Row[Any], wanted: Sequence[PutBack], artifacts: Mapping[str, Row[Any]]
) -> tuple[list[str], dict[str, uuid.UUID]]:
    problems, made = [], {}
    for each in wanted:
        try:
            await check_path_free(db, row.mission_id, each.to)
        except KleinkramError as error:
            problems.append(f"{each.path} was not put back: {error}")
            continue
        made[each.to] = await _make(db, row, each, artifacts[each.path])
    return problems, made


async def _make(db: Connection, row: Row[Any], wanted: PutBack, artifact: Row[Any]) -> uuid.UUID:
    file_id = uuid.uuid4()
    values = {"mission_id": row.mission_id, "blob_id": artifact.blob_id, "uploaded_by_id": row.started_by_id}
    place = {"path": wanted.to, "path_key": name_key(wanted.to), "origin": "run"}
    await db.execute(insert(file).values(id=file_id, **values, **place))
    lineage = {"file_id": file_id, "made_from": wanted.made_from}
    await db.execute(update(run_artifact).where(run_artifact.c.id == artifact.id).values(**lineage))
    # As an artifact, nobody read it: as a file it may be a recording.
    unread = {"content": ContentState.pending.value, "summarised_at": None}
    await db.execute(update(blob).where(blob.c.id == artifact.blob_id).values(**unread))
    await examine_blobs(db, [artifact.blob_id])
    return file_id
