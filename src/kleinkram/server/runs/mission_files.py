"""Artifacts of a run that become files of its mission, as its report requests."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from sqlalchemy import insert, update

from kleinkram.contract.access import Right
from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.errors import KleinkramError
from kleinkram.contract.files import ContentState
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.reports import MissionFile
from kleinkram.server.access.actor import find_person
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.blobs.service import enqueue_reading
from kleinkram.server.db import Connection
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.missions import service as missions
from kleinkram.server.quotas import Amount, require_room
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.tables import blob, file, run_artifact


class RunArtifact(NamedTuple):
    """An artifact of a run, with its stored bytes."""

    id: uuid.UUID
    path: str
    blob_id: uuid.UUID
    size_bytes: int


class EndedRun(NamedTuple):
    """A run whose end is being recorded."""

    id: uuid.UUID
    mission_id: uuid.UUID
    project_id: uuid.UUID
    started_by_id: uuid.UUID
    definition: ActionDefinition


async def create_mission_files(
    db: Connection, ended: EndedRun, selected: Sequence[MissionFile], artifacts: Mapping[str, RunArtifact]
) -> list[str]:
    """Create files of the mission from artifacts of a run; return sentences about those that could not be created.

    Existing files are never changed. The actor is the person who launched the run, with their current rights.
    """
    selected = [entry for entry in selected if entry.path in artifacts]
    if not selected:
        return []
    most = ended.definition.right
    starter = await find_person(db, ended.started_by_id)
    if starter is None or most.level < Right.create.level:
        return ["Files of the mission require an action with `right: CREATE`; they stay artifacts."]
    actor = replace(starter.for_request("begin_uploads", request_id=None, address=None), max_right=most)
    try:
        await missions.lock_mission_to_fill(db, actor, ended.mission_id)
        size_bytes = sum(artifacts[entry.path].size_bytes for entry in selected)
        await require_room(db, actor, project_id=ended.project_id, requested=Amount(len(selected), size_bytes))
    except KleinkramError as error:
        return [f"No file of the mission was created; the artifacts stay: {error}"]
    problems: list[str] = []
    events: list[Event] = []
    after: Metadata = {"run_id": str(ended.id), "action": ended.definition.name}
    for entry in selected:
        try:
            await check_path_free(db, ended.mission_id, entry.to)
        except KleinkramError as error:
            problems.append(f"{entry.path} did not become a file of the mission: {error}")
            continue
        file_id = await _create_file(db, ended, entry, artifacts[entry.path])
        events.append(
            Event("file.create", "file", file_id, entry.to, ended.project_id, after=after, mission_id=ended.mission_id)
        )
    if events:
        await audit(db, actor, *events)
        await derive_again(db, ended.mission_id)
    return problems


async def _create_file(db: Connection, ended: EndedRun, selected: MissionFile, artifact: RunArtifact) -> uuid.UUID:
    file_id = uuid.uuid4()
    values = {"mission_id": ended.mission_id, "blob_id": artifact.blob_id, "uploaded_by_id": ended.started_by_id}
    path = {"path": selected.to, "path_key": name_key(selected.to), "origin": "run"}
    await db.execute(insert(file).values(id=file_id, **values, **path))
    lineage = {"file_id": file_id, "derived_from": selected.derived_from}
    await db.execute(update(run_artifact).where(run_artifact.c.id == artifact.id).values(**lineage))
    # The content of artifacts is not read; as a file it may be a recording.
    unread = {"content": ContentState.pending.value, "summarised_at": None}
    await db.execute(update(blob).where(blob.c.id == artifact.blob_id).values(**unread))
    await enqueue_reading(db, [artifact.blob_id])
    return file_id
