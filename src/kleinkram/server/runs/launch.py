"""Making runs: what they are given is decided here, once, and stays."""

import hashlib
import json
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, false, func, insert, or_, select

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
from kleinkram.contract.rights import Right
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
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection
from kleinkram.server.filters.files import filter_files
from kleinkram.server.runners.scheduling import (
    Needs,
    alive_runners,
    has_single_person,
    known_runners,
    reason_never_starts,
)
from kleinkram.server.runs import service
from kleinkram.server.tables import action, action_version, blob, file, mission, project, run, run_input

# What a run says of its results, and a run that reuses them says too.
_SAID = ("problems", "proposed", "previews", "artifact_count", "metric_count", "finding_counts")
_UNREADABLE = {BlobState.lost.value, BlobState.corrupt.value}
# What a runner puts into `/in` itself; no input can stand there.
_RESERVED = {CONTEXT_FILE, ".kleinkram"}


@dataclass(frozen=True)
class Runners:
    """The runners that may do a run, and whether one person alone has an account."""

    known: Sequence[Row[Any]]
    single_person: bool


@dataclass(frozen=True)
class Task:
    """What is to be run, wherever."""

    version_id: uuid.UUID
    definition: ActionDefinition
    image_digest: str | None
    # Of whose missions alone it is; null for those of all.
    project_id: uuid.UUID | None
    parameters: ParameterValues
    runners: Runners


async def launch(db: Connection, actor: Actor, *, wanted: RunsCreate) -> RunsCreated:
    """Make a run on each mission; one that cannot be made does not keep the others from it.

    Raises:
        NotFound: the action, or its version, is not there, or not for this actor.
        InvalidRequest: it is archived, or its parameters are not what they should be.
    """
    task = await _task(db, actor, wanted)
    wanted_ids = dict.fromkeys(wanted.mission_ids)
    return RunsCreated(items=[await _made_or_refused(db, actor, task, each, force=wanted.force) for each in wanted_ids])


async def _made_or_refused(
    db: Connection, actor: Actor, task: Task, mission_id: uuid.UUID, *, force: bool
) -> RunCreated | RunRefused:
    try:
        return RunCreated(run=await make_run(db, actor, task, mission_id, force=force))
    except KleinkramError as error:  # found before anything of that run is written
        return RunRefused(mission_id=mission_id, problem=to_problem(error, actor.request_id))


async def task_of(db: Connection, version_id: uuid.UUID, parameters: ParameterValues) -> Task:
    """Return what an earlier run ran, to be run again."""
    stmt = select(action_version, action.c.project_id).outerjoin(action, action.c.id == action_version.c.action_id)
    row = (await db.execute(stmt.where(action_version.c.id == version_id))).one()
    definition = ActionDefinition.model_validate(row.definition)
    return Task(version_id, definition, row.image_digest, row.project_id, parameters, await _runners(db))


async def make_run(
    db: Connection,
    actor: Actor,
    task: Task,
    mission_id: uuid.UUID,
    *,
    force: bool,
    retry_of_id: uuid.UUID | None = None,
) -> RunRead:
    """Put one run into the queue, or let it have the results of an earlier one.

    Raises:
        NotFound: the mission is not there, or not for this actor.
        Forbidden: they may see it, but hold less on it than the action asks for.
        InvalidRequest: the action is of another project.
        NoInputs: no file of it is an input.
        FileUnavailable: an input is lost or corrupt.
        NoRunner: none of the runners can ever do it.
    """
    place = await _place(db, actor, task, mission_id)
    inputs = await _inputs(db, actor, task.definition, place)
    given = _assign(task, inputs)
    earlier = None if force else await _earlier(db, task, mission_id, given)
    if earlier is None:
        _raise_if_never(task, place.project_id)
    run_id = uuid.uuid4()
    values = _values(task, inputs) | {"given_sha256": given, "mission_id": mission_id, "started_by_id": actor.person_id}
    if earlier is not None:
        values |= _reusing(earlier)
    await db.execute(insert(run).values(id=run_id, retry_of_id=retry_of_id, **values))
    rows = [
        {
            "run_id": run_id,
            "path": each.path,
            "size_bytes": each.size_bytes,
            "sha256": each.sha256,
            "blob_id": each.blob_id,
            "file_id": each.id,
        }
        for each in inputs
    ]
    await db.execute(insert(run_input), rows)
    name, after = task.definition.name, _told(task, inputs, earlier)
    await record(
        db, actor, Event("run.create", "run", run_id, name, place.project_id, after=after, mission_id=mission_id)
    )
    return await service.get_run(db, actor, run_id)


async def retry_run(db: Connection, actor: Actor, *, run_id: uuid.UUID, force: bool) -> RunRead:
    """Run the same once more, on the files as they are now, and return the new run.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: they hold less on its mission than the action asks for.
        NoInputs: no file of it is an input any more.
        FileUnavailable: an input is lost or corrupt.
        NoRunner: none of the runners can ever do it.
    """
    row = await service.find_run_row(db, actor, run_id)
    task = await task_of(db, row.version_id, row.parameters)
    return await make_run(db, actor, task, row.mission_id, force=force, retry_of_id=run_id)


async def _task(db: Connection, actor: Actor, wanted: RunsCreate) -> Task:
    project_id = None
    if wanted.action_id is not None:
        version = await actions.get_version(db, actor, action_id=wanted.action_id, number=wanted.version)
        definition, version_id, digest = version.definition, version.id, version.image_digest
        of_action = select(action.c.project_id).where(action.c.id == wanted.action_id)
        project_id = (await db.execute(of_action)).scalar_one()
    elif wanted.definition is not None:
        definition = wanted.definition
        version_id, digest = await actions.store_unpublished(db, actor, definition)
    else:
        raise AssertionError("a request names an action or holds one")
    try:
        parameters = definition.fill_in(wanted.parameters)
    except ParametersWrong as error:
        problems = [FieldProblem(field=f"parameters.{name}", message=said) for name, said in error.problems.items()]
        raise InvalidRequest(problems=problems) from error
    return Task(version_id, definition, digest, project_id, parameters, await _runners(db))


async def _runners(db: Connection) -> Runners:
    return Runners(await known_runners(db), await has_single_person(db))


def _raise_if_never(task: Task, project_id: uuid.UUID) -> None:
    """Refuse a run that no runner can ever do, with the remedy."""
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
    """Return name, project and one's level of the mission, once it is seen that the action may be run there."""
    columns = (mission.c.name, mission.c.project_id, level_on_mission(actor).label("level"), mission.c.id)
    stmt = visible_missions(actor).with_only_columns(*columns, maintain_column_froms=True)
    # Kept from being deleted until the run is there; whoever deletes it then finds the run.
    held = stmt.where(mission.c.id == mission_id).with_for_update(read=True, key_share=True, of=[mission, project])
    row = (await db.execute(held)).one_or_none()
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
    wanted = definition.inputs
    matching = FileFilter(
        mission_id=place.id, path=wanted.paths, topic=wanted.topics, message_type=wanted.message_types
    )
    columns = (file.c.id, file.c.path, file.c.blob_id, blob.c.size_bytes, blob.c.sha256, blob.c.state)
    stmt = filter_files(actor, visible_files(actor), matching).with_only_columns(*columns, maintain_column_froms=True)
    rows = (await db.execute(stmt.order_by(file.c.path))).all()
    if not rows:
        said = [f"{name} {', '.join(globs)}" for name, globs in wanted.model_dump().items() if globs]
        told = " and ".join(said).replace("_", " ") or "any file"
        raise NoInputs(mission=place.name, action=definition.name, inputs=told)
    for row in rows:
        if row.state in _UNREADABLE:
            raise FileUnavailable(path=row.path, state=row.state)
        if row.path.partition("/")[0] in _RESERVED:
            message = f"the file {row.path!r} stands where a run finds what it is told; rename it"
            raise InvalidRequest(problems=[FieldProblem(field="mission_ids", message=message)])
    return rows


def _assign(task: Task, inputs: Sequence[Row[Any]]) -> bytes:
    """Return the hash of all that decides about results, but for the image."""
    said = [str(task.version_id), task.parameters, [[row.path, row.sha256.hex()] for row in inputs]]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).digest()


async def _earlier(db: Connection, task: Task, mission_id: uuid.UUID, given: bytes) -> Row[Any] | None:
    """Return the latest good run of the same on the same mission, by an image that would be run now too."""
    images = {task.image_digest} - {None}
    if task.definition.image is None:
        images = {each.default_image for each in await alive_runners(db)}
    same_image = or_(false(), *(run.c.image_digest.is_not_distinct_from(each) for each in images))
    good = (run.c.given_sha256 == given) & (run.c.state == RunState.done.value) & run.c.reuses_id.is_(None)
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
        "message": "The very same was run before, and its results stand for this run too.",
        "exit_code": earlier.exit_code,
        "image_digest": earlier.image_digest,
        "reuses_id": earlier.id,
        "ended_at": func.now(),
        **{key: earlier._mapping[key] for key in _SAID},
    }


def _told(task: Task, inputs: Sequence[Row[Any]], earlier: Row[Any] | None) -> Metadata:
    told: Metadata = {"version_id": str(task.version_id), "parameters": dict(task.parameters), "files": len(inputs)}
    return told if earlier is None else {**told, "reuses_id": str(earlier.id)}
