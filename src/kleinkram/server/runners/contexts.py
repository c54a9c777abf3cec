"""The content of `/in/mission.json`: what a run sees of its mission beside the bytes of its inputs."""

import itertools
import operator
import uuid
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from sqlalchemy import select

from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.errors import RunGone
from kleinkram.contract.files import FileRead, RecordingRead, TopicRead
from kleinkram.contract.missions import MissionRead
from kleinkram.contract.runners import RunAttempt, RunContexts
from kleinkram.contract.runs import ActionRef, Cause, RunContext
from kleinkram.server.access.actor import Actor, find_person
from kleinkram.server.access.visible import visible_files
from kleinkram.server.db import Connection, among
from kleinkram.server.files import queries as files
from kleinkram.server.missions import service as missions
from kleinkram.server.recordings import queries as recordings
from kleinkram.server.runners.assigned_runs import (
    AssignedRun,
    find_definitions,
    lock_assigned_run,
    lock_assigned_runs,
    require_own,
)
from kleinkram.server.runs.declared_inputs import checks_at_launch, mission_at_launch, reference_at_launch
from kleinkram.server.tables import file, run_input


async def get_context(db: Connection, actor: Actor, *, run_id: uuid.UUID, attempt: int) -> RunContext:
    """Return the context of a run, with the files that still exist.

    Raises:
        RunGone: the runner does not have the run by this attempt, or its mission is not visible any more.
    """
    row = await lock_assigned_run(db, actor, run_id, attempt)
    context = (await _read_contexts(db, [row])).get(run_id)
    if context is None:
        raise RunGone(run_id=str(run_id))
    return context


async def get_contexts(
    db: Connection, actor: Actor, *, runner_id: uuid.UUID, requested: Sequence[RunAttempt]
) -> RunContexts:
    """Return the contexts of several runs in the order requested: as `get_context`, with null for RunGone.

    Raises:
        NotFound: the token is not this runner's.
    """
    require_own(actor, runner_id)
    rows = await lock_assigned_runs(db, actor, {one.run_id: one.attempt for one in requested})
    contexts = await _read_contexts(db, rows)
    return RunContexts(contexts=[contexts.get(one.run_id) for one in requested])


class _Seen(NamedTuple):
    """What one person may see of the missions of runs and of their inputs, by id."""

    missions: dict[uuid.UUID, MissionRead]
    files: dict[uuid.UUID, FileRead]
    topics: dict[uuid.UUID, list[TopicRead]]
    recordings: dict[uuid.UUID, list[RecordingRead]]


async def _read_contexts(db: Connection, rows: Sequence[AssignedRun]) -> dict[uuid.UUID, RunContext]:
    definitions = await find_definitions(db, rows)
    contexts: dict[uuid.UUID, RunContext] = {}
    started_by = operator.attrgetter("started_by_id")
    for person_id, group in itertools.groupby(sorted(rows, key=started_by), key=started_by):
        starter = await find_person(db, person_id)
        if starter is None:
            continue
        own = [*group]
        input_ids = await _input_ids(db, own)
        seen = await _see(
            db, starter, {row.mission_id for row in own}, itertools.chain.from_iterable(input_ids.values())
        )
        for row in own:
            if row.mission_id in seen.missions:
                definition = definitions[row.version_id]
                contexts[row.id] = await _context(db, starter, row, definition, seen, input_ids[row.id])
    return contexts


async def _input_ids(db: Connection, rows: Sequence[AssignedRun]) -> dict[uuid.UUID, set[uuid.UUID]]:
    """Return the ids of the files, of those that still exist, that are inputs of runs."""
    stmt = select(run_input.c.run_id, run_input.c.file_id).where(run_input.c.file_id.is_not(None))
    ids: dict[uuid.UUID, set[uuid.UUID]] = {row.id: set() for row in rows}
    for run_id, file_id in await db.execute(stmt.where(among(run_input.c.run_id, ids))):
        ids[run_id].add(file_id)
    return ids


async def _see(db: Connection, starter: Actor, mission_ids: set[uuid.UUID], file_ids: Iterable[uuid.UUID]) -> _Seen:
    inputs = visible_files(starter).where(among(file.c.id, {*file_ids}))
    topics: dict[uuid.UUID, list[TopicRead]] = defaultdict(list)
    for topic in files.to_topics((await db.execute(files.topic_rows(inputs))).all()):
        topics[topic.file_id].append(topic)
    named: dict[uuid.UUID, list[RecordingRead]] = defaultdict(list)
    for row in await db.execute(recordings.recordings_of(starter, mission_ids)):
        named[row.mission_id].append(recordings.to_recording(row))
    read = files.to_files((await db.execute(files.file_rows(inputs))).all())
    return _Seen(await missions.get_missions(db, starter, mission_ids), {one.id: one for one in read}, topics, named)


async def _context(
    db: Connection,
    starter: Actor,
    row: AssignedRun,
    definition: ActionDefinition,
    seen: _Seen,
    input_ids: set[uuid.UUID],
) -> RunContext:
    declared = definition.inputs
    inputs = sorted((seen.files[one] for one in input_ids if one in seen.files), key=operator.attrgetter("path"))
    return RunContext(
        run_id=row.id,
        action=ActionRef(id=row.action_id, name=row.action_name, version=row.version_number),
        parameters=row.parameters,
        cause=Cause(person=starter.ref, retry_of_id=row.retry_of_id),
        mission=mission_at_launch(declared, row.input_metadata, seen.missions[row.mission_id]),
        files=inputs,
        topics=[topic for one in inputs for topic in seen.topics[one.id]],
        recordings=seen.recordings[row.mission_id],
        checks=await checks_at_launch(db, declared, row.project_id, row.checks_sha256),
        reference=await reference_at_launch(db, declared, row.input_metadata, row.checks_sha256),
    )
