"""Launches runs. Inputs and parameters of a run are fixed here."""

import hashlib
import json
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, false, func, insert, or_, select

from kleinkram.contract.access import Right
from kleinkram.contract.actions import ActionDefinition, ParametersWrong, ParameterValues
from kleinkram.contract.errors import (
    FieldProblem,
    FileUnavailable,
    Forbidden,
    InvalidRequest,
    KleinkramError,
    NoInputs,
    NoRunner,
    NotFound,
)
from kleinkram.contract.files import BlobState, FileFilter
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.problems import to_problem
from kleinkram.contract.runs import (
    CONTEXT_FILE,
    EndReason,
    RunCreated,
    RunRead,
    RunRefused,
    RunsCreate,
    RunsCreated,
    RunState,
)
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import level_on_mission, visible_files, visible_missions
from kleinkram.server.actions import service as actions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection
from kleinkram.server.filters.files import filter_files
from kleinkram.server.runners.eligibility import (
    Needs,
    alive_runners,
    has_single_person,
    known_runners,
    reason_never_starts,
)
from kleinkram.server.runs import service
from kleinkram.server.tables import action, action_version, blob, file, mission, project, run, run_input

# The columns that a run takes over from the run whose results it reuses.
_REUSED_COLUMNS = ("problems", "proposed", "previews", "artifact_count", "metric_count", "finding_counts")
_UNREADABLE = {BlobState.lost.value, BlobState.corrupt.value}
# Names in `/in` that runners use themselves.
_RESERVED = {CONTEXT_FILE, ".kleinkram"}


@dataclass(frozen=True)
class KnownRunners:
    """The known runners, and whether a single person has an account."""

    known: Sequence[Row[Any]]
    single_person: bool


@dataclass(frozen=True)
class Task:
    """An action with parameters, not yet bound to a mission."""

    version_id: uuid.UUID
    definition: ActionDefinition
    image_digest: str | None
    # The project of the action; None for the whole lab.
    project_id: uuid.UUID | None
    parameters: ParameterValues
    runners: KnownRunners


async def launch(db: Connection, actor: Actor, *, requested: RunsCreate) -> RunsCreated:
    """Create a run on each mission; failures are independent of each other.

    Raises:
        NotFound: the action, or its version, is not there, or not for this actor.
        InvalidRequest: it is archived, or its parameters are invalid.
    """
    task = await _task(db, actor, requested)
    mission_ids = dict.fromkeys(requested.mission_ids)
    return RunsCreated(
        items=[await _create_or_refuse(db, actor, task, entry, force=requested.force) for entry in mission_ids]
    )


async def _create_or_refuse(
    db: Connection, actor: Actor, task: Task, mission_id: uuid.UUID, *, force: bool
) -> RunCreated | RunRefused:
    try:
        return RunCreated(run=await create_run(db, actor, task, mission_id, force=force))
    except KleinkramError as error:  # found before anything of that run is written
        return RunRefused(mission_id=mission_id, problem=to_problem(error, actor.request_id))


async def task_of(db: Connection, version_id: uuid.UUID, parameters: ParameterValues) -> Task:
    """Return the task of an earlier run."""
    stmt = select(action_version, action.c.project_id).outerjoin(action, action.c.id == action_version.c.action_id)
    row = (await db.execute(stmt.where(action_version.c.id == version_id))).one()
    definition = ActionDefinition.model_validate(row.definition)
    return Task(version_id, definition, row.image_digest, row.project_id, parameters, await _runners(db))


async def create_run(
    db: Connection,
    actor: Actor,
    task: Task,
    mission_id: uuid.UUID,
    *,
    force: bool,
    retry_of_id: uuid.UUID | None = None,
) -> RunRead:
    """Queue a run, or have it reuse the results of an earlier one.

    Raises:
        NotFound: the mission is not there, or not for this actor.
        Forbidden: their right on it is lower than the action requires.
        InvalidRequest: the action is of another project.
        NoInputs: no file of it is an input.
        FileUnavailable: an input is lost or corrupt.
        NoRunner: no runner can ever execute it.
    """
    place = await _place(db, actor, task, mission_id)
    inputs = await _inputs(db, actor, task.definition, place)
    fingerprint = _assign(task, inputs)
    earlier = None if force else await _earlier(db, task, mission_id, fingerprint)
    if earlier is None:
        _raise_if_never(task, place.project_id)
    run_id = uuid.uuid4()
    values = _values(task, inputs) | {
        "inputs_fingerprint": fingerprint,
        "mission_id": mission_id,
        "started_by_id": actor.person_id,
    }
    if earlier is not None:
        values |= _reusing(earlier)
    await db.execute(insert(run).values(id=run_id, retry_of_id=retry_of_id, **values))
    rows = [
        {
            "run_id": run_id,
            "path": entry.path,
            "size_bytes": entry.size_bytes,
            "sha256": entry.sha256,
            "blob_id": entry.blob_id,
            "file_id": entry.id,
        }
        for entry in inputs
    ]
    await db.execute(insert(run_input), rows)
    name, after = task.definition.name, _audit_details(task, inputs, earlier)
    await audit(
        db, actor, Event("run.create", "run", run_id, name, place.project_id, after=after, mission_id=mission_id)
    )
    return await service.get_run(db, actor, run_id)


async def retry_run(db: Connection, actor: Actor, *, run_id: uuid.UUID, force: bool) -> RunRead:
    """Launch the same action again, on the current files, and return the new run.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: their right on its mission is lower than the action requires.
        NoInputs: no file of it is an input any more.
        FileUnavailable: an input is lost or corrupt.
        NoRunner: no runner can ever execute it.
    """
    row = await service.find_run_row(db, actor, run_id)
    task = await task_of(db, row.version_id, row.parameters)
    return await create_run(db, actor, task, row.mission_id, force=force, retry_of_id=run_id)


async def _task(db: Connection, actor: Actor, requested: RunsCreate) -> Task:
    project_id = None
    if requested.action_id is not None:
        version = await actions.get_version(db, actor, action_id=requested.action_id, number=requested.version)
        definition, version_id, digest = version.definition, version.id, version.image_digest
        of_action = select(action.c.project_id).where(action.c.id == requested.action_id)
        project_id = (await db.execute(of_action)).scalar_one()
    elif requested.definition is not None:
        definition = requested.definition
        version_id, digest = await actions.store_unpublished(db, actor, definition)
    else:
        raise AssertionError("a request names an action or holds one")
    try:
        parameters = definition.fill_in(requested.parameters)
    except ParametersWrong as error:
        problems = [FieldProblem(field=f"parameters.{name}", message=parts) for name, parts in error.problems.items()]
        raise InvalidRequest(problems=problems) from error
    return Task(version_id, definition, digest, project_id, parameters, await _runners(db))


async def _runners(db: Connection) -> KnownRunners:
    return KnownRunners(await known_runners(db), await has_single_person(db))


def _raise_if_never(task: Task, project_id: uuid.UUID) -> None:
    """Refuse a run that no runner can ever execute, with the remedy."""
    needs = _needs(task.definition, project_id)
    reason = reason_never_starts(needs, task.runners.known, single_person=task.runners.single_person)
    if reason is not None:
        raise NoRunner(action=task.definition.name, reason=reason)


def _needs(definition: ActionDefinition, project_id: uuid.UUID | None = None) -> Needs:
    needed = definition.resources
    return Needs(
        project_id=project_id,
        labels=needed.labels,
        needs_images=definition.image is not None,
        network=definition.network.value,
        cores=needed.cores,
        memory_bytes=needed.memory_bytes,
        disk_bytes=needed.disk_bytes,
        gpus=needed.gpus,
    )


async def _place(db: Connection, actor: Actor, task: Task, mission_id: uuid.UUID) -> Row[Any]:
    """Return name, project and the actor's level of a mission on which they may run the action."""
    columns = (mission.c.name, mission.c.project_id, level_on_mission(actor).label("level"), mission.c.id)
    stmt = visible_missions(actor).with_only_columns(*columns, maintain_column_froms=True)
    # Locked against deletion until the run exists.
    locked = stmt.where(mission.c.id == mission_id).with_for_update(read=True, key_share=True, of=[mission, project])
    row = (await db.execute(locked)).one_or_none()
    if row is None:
        raise NotFound(noun="mission", ref=str(mission_id))
    needed = max(Right.create, task.definition.right, key=lambda right: right.level)
    if row.level < needed.level:
        raise Forbidden(noun="mission", operation=f"run {task.definition.name} on it", needs=needed.value)
    if task.project_id not in {None, row.project_id}:
        message = (
            f"{task.definition.name} is an action of another project; publish it in this one, or for the whole lab"
        )
        raise InvalidRequest(problems=[FieldProblem(field="action_id", message=message)])
    return row


async def _inputs(db: Connection, actor: Actor, definition: ActionDefinition, place: Row[Any]) -> Sequence[Row[Any]]:
    requested = definition.inputs
    matching = FileFilter(
        mission_id=place.id, path=requested.paths, topic=requested.topics, message_type=requested.message_types
    )
    columns = (file.c.id, file.c.path, file.c.blob_id, blob.c.size_bytes, blob.c.sha256, blob.c.state)
    stmt = filter_files(actor, visible_files(actor), matching).with_only_columns(*columns, maintain_column_froms=True)
    rows = (await db.execute(stmt.order_by(file.c.path))).all()
    if not rows:
        parts = [f"{name} {', '.join(globs)}" for name, globs in requested.model_dump().items() if globs]
        details = " and ".join(parts).replace("_", " ") or "any file"
        raise NoInputs(mission=place.name, action=definition.name, inputs=details)
    for row in rows:
        if row.state in _UNREADABLE:
            raise FileUnavailable(path=row.path, state=row.state)
        if row.path.partition("/")[0] in _RESERVED:
            message = f"the file {row.path!r} has a name that runners use in /in; rename it"
            raise InvalidRequest(problems=[FieldProblem(field="mission_ids", message=message)])
    return rows


def _assign(task: Task, inputs: Sequence[Row[Any]]) -> bytes:
    """Return the hash of everything that determines the results, except the image."""
    parts = [str(task.version_id), task.parameters, [[row.path, row.sha256.hex()] for row in inputs]]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).digest()


async def _earlier(db: Connection, task: Task, mission_id: uuid.UUID, fingerprint: bytes) -> Row[Any] | None:
    """Return the latest successful run with the same fingerprint, mission and image."""
    images = {task.image_digest} - {None}
    if task.definition.image is None:
        images = {entry.default_image for entry in await alive_runners(db)}
    same_image = or_(false(), *(run.c.image_digest.is_not_distinct_from(entry) for entry in images))
    good = (run.c.inputs_fingerprint == fingerprint) & (run.c.state == RunState.done.value) & run.c.reuses_id.is_(None)
    stmt = select(run).where(good, run.c.mission_id == mission_id, same_image)
    return (await db.execute(stmt.order_by(run.c.ended_at.desc()).limit(1))).one_or_none()


def _values(task: Task, inputs: Sequence[Row[Any]]) -> dict[str, Any]:
    return {
        **{name: value for name, value in _needs(task.definition)._asdict().items() if name != "project_id"},
        "version_id": task.version_id,
        "parameters": task.parameters,
        "input_count": len(inputs),
        "input_bytes": sum(row.size_bytes for row in inputs),
    }


def _reusing(earlier: Row[Any]) -> dict[str, Any]:
    return {
        "state": RunState.done.value,
        "reason": EndReason.done.value,
        "message": "It was run before with the same inputs and parameters; those results are reused.",
        "exit_code": earlier.exit_code,
        "image_digest": earlier.image_digest,
        "reuses_id": earlier.id,
        "ended_at": func.now(),
        **{key: earlier._mapping[key] for key in _REUSED_COLUMNS},
    }


def _audit_details(task: Task, inputs: Sequence[Row[Any]], earlier: Row[Any] | None) -> Metadata:
    details: Metadata = {"version_id": str(task.version_id), "parameters": dict(task.parameters), "files": len(inputs)}
    return details if earlier is None else {**details, "reuses_id": str(earlier.id)}
