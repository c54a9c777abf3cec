"""Launches runs: fixes their inputs and parameters, and queues them or reuses earlier results."""

import hashlib
import json
import uuid
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

from sqlalchemy import false, func, insert, or_, select

from kleinkram import traces
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
from kleinkram.contract.files import FileFilter
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.problems import to_problem
from kleinkram.contract.runs import (
    CONTEXT_FILE,
    EndReason,
    RunCreated,
    RunPriority,
    RunRead,
    RunRefused,
    RunsCreate,
    RunsCreated,
    RunState,
)
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import level_on_mission, visible_files, visible_missions
from kleinkram.server.actions import dependency_locks
from kleinkram.server.actions import service as actions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, among
from kleinkram.server.filters.files import filter_files
from kleinkram.server.jobs.rejudge import judge_again_for_runs
from kleinkram.server.runs import service
from kleinkram.server.runs.declared_inputs import DeclaredInputs, read_declared_inputs
from kleinkram.server.runs.eligibility import ENVIRONMENTS_LABEL, KnownRunners, Needs, known_runners
from kleinkram.server.tables import DERIVED_ORIGIN, action, action_version, blob, file, mission, project, run, run_input

# The columns that a run takes over from the run whose results it reuses.
_REUSED_COLUMNS = (
    *("exit_code", "image_digest", "isolation", "problems", "proposed", "previews"),
    *("artifact_count", "metric_count", "finding_counts", "check_counts", "verdict"),
)
# Names in `/in` that runners use themselves.
_RESERVED = {CONTEXT_FILE, ".kleinkram"}


class PreparedAction(NamedTuple):
    """An action to run, not yet bound to a mission. `project_id` None: an action of the whole lab."""

    version_id: uuid.UUID
    definition: ActionDefinition
    image_digest: str | None
    project_id: uuid.UUID | None
    parameters: ParameterValues
    priority: RunPriority
    runners: KnownRunners


class TargetMission(NamedTuple):
    """A mission, the isolation that its project allows, and the actor's level on it."""

    id: uuid.UUID
    name: str
    project_id: uuid.UUID
    isolation: Isolation
    level: int


class Input(NamedTuple):
    """A file of a mission that a run reads."""

    id: uuid.UUID
    path: str
    blob_id: uuid.UUID
    size_bytes: int
    sha256: bytes
    state: str
    is_derived: bool


class PlannedRun(NamedTuple):
    """A mission, and what a run on it reads."""

    target: TargetMission
    inputs: list[Input]
    declared: DeclaredInputs


async def launch(context: AppContext, actor: Actor, *, requested: RunsCreate) -> RunsCreated:
    """Create a run on each mission; failures are independent of each other. Opens its own transactions.

    Raises:
        NotFound: the action, or its version, is not there, or not for this actor.
        InvalidRequest: it is archived, its parameters are invalid, or its dependencies cannot be locked.
    """
    unpublished, is_locked_here = requested.definition, False
    if unpublished is not None and dependency_locks.needs_lock(unpublished, context.settings):
        async with context.database.begin() as db:
            known = await actions.find_unpublished(db, unpublished, is_to_lock=True)
            is_refused = not await _may_run_on_any(db, actor, unpublished, requested.mission_ids)
        if known is not None:
            unpublished, is_locked_here = known.definition, True
        elif not is_refused:  # otherwise each mission says why
            _fill_in(unpublished, requested.parameters)
            unpublished, is_locked_here = await dependency_locks.lock(unpublished, context.settings), True
    async with context.database.begin() as db:
        locked = requested.model_copy(update={"definition": unpublished})
        runners = await known_runners(db, context.settings.weakest_isolation)
        return await _launch(db, actor, locked, runners, is_locked_here=is_locked_here)


async def _may_run_on_any(
    db: Connection, actor: Actor, definition: ActionDefinition, mission_ids: Sequence[uuid.UUID]
) -> bool:
    needed = max(Right.create, definition.right, key=lambda right: right.level)
    levels = visible_missions(actor).with_only_columns(level_on_mission(actor), maintain_column_froms=True)
    rows = (await db.execute(levels.where(among(mission.c.id, mission_ids)))).scalars()
    return any(level >= needed.level for level in rows)


async def _launch(
    db: Connection, actor: Actor, requested: RunsCreate, runners: KnownRunners, *, is_locked_here: bool
) -> RunsCreated:
    task = await _task(db, actor, requested, runners, is_locked_here=is_locked_here)
    items: list[RunCreated | RunRefused] = []
    for mission_id in dict.fromkeys(requested.mission_ids):
        try:
            items.append(RunCreated(run=await create_run(db, actor, task, mission_id, force=requested.force)))
        except KleinkramError as error:  # noqa: PERF203  raised before anything of that run is written
            items.append(RunRefused(mission_id=mission_id, problem=to_problem(error, actor.request_id)))
    return RunsCreated(items=items)


async def create_run(
    db: Connection,
    actor: Actor,
    task: PreparedAction,
    mission_id: uuid.UUID,
    *,
    force: bool,
    retry_of_id: uuid.UUID | None = None,
) -> RunRead:
    """Queue a run, or have it reuse the results of an earlier one.

    Raises:
        NotFound: the mission is not there, or not for this actor.
        Forbidden: their right on it is lower than the action, or its priority, requires.
        InvalidRequest: the action is of another project.
        NoInputs: no file of it is an input.
        FileUnavailable: an input is lost or corrupt.
        NoRunner: no runner can ever execute it.
    """
    planned = await plan_run(db, actor, task, mission_id)
    return await start_run(db, actor, task, planned, force=force, retry_of_id=retry_of_id)


async def plan_run(db: Connection, actor: Actor, task: PreparedAction, mission_id: uuid.UUID) -> PlannedRun:
    """Return what a run would read, its mission locked against deletion. Raises as `create_run`, except NoRunner."""
    target = await _find_target(db, actor, task, mission_id)
    inputs = await _find_inputs(db, actor, task.definition, target)
    declared = await read_declared_inputs(db, task.definition.inputs, [target.id])
    return PlannedRun(target, inputs, declared[target.id])


async def start_run(
    db: Connection,
    actor: Actor,
    task: PreparedAction,
    planned: PlannedRun,
    *,
    force: bool,
    retry_of_id: uuid.UUID | None = None,
) -> RunRead:
    """Queue a planned run, or have it reuse the results of an earlier one.

    Raises:
        NoRunner: no runner can ever execute it.
    """
    target, inputs, declared = planned
    mission_id = target.id
    fingerprint = inputs_fingerprint(task.version_id, task.parameters, inputs, declared)
    reused = None if force else await _reusable_results(db, task, mission_id, fingerprint)
    needs = _needs(task.definition, target)
    if reused is None and (reason := task.runners.reason_never_starts(needs)) is not None:
        raise NoRunner(action=task.definition.name, reason=reason)
    run_id = uuid.uuid4()
    values = {name: value for name, value in needs._asdict().items() if name in run.c} | {
        "version_id": task.version_id,
        "parameters": task.parameters,
        "priority": task.priority.value,
        "input_count": len(inputs),
        "input_bytes": sum(entry.size_bytes for entry in inputs),
        "inputs_fingerprint": fingerprint,
        "input_metadata": declared.metadata,
        "checks_sha256": declared.checks_sha256,
        "mission_id": mission_id,
        "launch_project_id": target.project_id,
        "started_by_id": actor.person_id,
        "retry_of_id": retry_of_id,
        "traceparent": traces.traceparent(),
    }
    await db.execute(insert(run).values(id=run_id, **values, **(reused or {})))
    await store_inputs(db, run_id, inputs)
    await judge_again_for_runs(db, [run_id])
    after: Metadata = {"version_id": str(task.version_id), "parameters": dict(task.parameters), "files": len(inputs)}
    if task.priority is not RunPriority.normal:
        after["priority"] = task.priority.value
    if reused is not None:
        after["reuses_id"] = str(reused["reuses_id"])
    name = task.definition.name
    event = Event("run.create", "run", run_id, name, target.project_id, after=after, mission_id=mission_id)
    await audit(db, actor, event)
    return await service.get_run(db, actor, run_id, weakest=task.runners.rule.weakest)


async def store_inputs(db: Connection, run_id: uuid.UUID, inputs: Sequence[Input]) -> None:
    """Store the inputs of a run as they are now; there is at least one."""
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


async def retry_run(db: Connection, actor: Actor, *, run_id: uuid.UUID, force: bool, weakest: Isolation) -> RunRead:
    """Launch the same action again, on the current files, and return the new run.

    It has the same priority, if the actor may use it. `weakest` is the setting `weakest_isolation`.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: their right on its mission is lower than the action requires.
        InvalidRequest: it was executed elsewhere.
        NoInputs: no file of it is an input any more.
        FileUnavailable: an input is lost or corrupt.
        NoRunner: no runner can ever execute it.
    """
    visible = await service.find_run(db, actor, run_id)
    earlier, priority = visible.run, visible.run.priority
    if earlier.is_recorded:
        message = "it was executed elsewhere, and only recorded here; run it there again"
        raise InvalidRequest(problems=[FieldProblem(field="run_id", message=message)])
    if priority is RunPriority.high and visible.level < Right.delete.level:
        priority = RunPriority.normal
    stmt = select(action_version.c.definition, action_version.c.image_digest, action.c.project_id)
    joined = stmt.outerjoin(action, action.c.id == action_version.c.action_id)
    row = (await db.execute(joined.where(action_version.c.id == earlier.version_id))).one()
    definition, runners = ActionDefinition.model_validate(row.definition), await known_runners(db, weakest)
    task = PreparedAction(
        earlier.version_id, definition, row.image_digest, row.project_id, earlier.parameters, priority, runners
    )
    return await create_run(db, actor, task, earlier.mission.id, force=force, retry_of_id=run_id)


async def _task(
    db: Connection, actor: Actor, requested: RunsCreate, runners: KnownRunners, *, is_locked_here: bool
) -> PreparedAction:
    project_id = None
    if requested.action_id is not None:
        version = await actions.get_version_to_run(db, actor, action_id=requested.action_id, number=requested.version)
        definition, version_id, digest = version.definition, version.id, version.image_digest
        of_action = select(action.c.project_id).where(action.c.id == requested.action_id)
        project_id = (await db.execute(of_action)).scalar_one()
    elif requested.definition is not None:
        stored = await actions.store_unpublished(db, actor, requested.definition, is_locked_here=is_locked_here)
        version_id, definition, digest = stored
    else:
        raise AssertionError("a request names an action or holds one")
    parameters = _fill_in(definition, requested.parameters)
    return PreparedAction(version_id, definition, digest, project_id, parameters, requested.priority, runners)


def _fill_in(definition: ActionDefinition, parameters: ParameterValues) -> ParameterValues:
    try:
        return definition.fill_in(parameters)
    except ParametersWrong as error:
        problems = [FieldProblem(field=f"parameters.{name}", message=parts) for name, parts in error.problems.items()]
        raise InvalidRequest(problems=problems) from error


def _needs(definition: ActionDefinition, target: TargetMission) -> Needs:
    needed = definition.resources
    return Needs(
        project_id=target.project_id,
        project_isolation=target.isolation,
        labels=[*needed.labels, *([ENVIRONMENTS_LABEL] if definition.lock is not None else [])],
        needs_images=definition.image is not None,
        network=definition.network.value,
        cores=needed.cores,
        memory_bytes=needed.memory_bytes,
        disk_bytes=needed.disk_bytes,
        gpus=needed.gpus,
    )


async def _find_target(db: Connection, actor: Actor, task: PreparedAction, mission_id: uuid.UUID) -> TargetMission:
    """Return a mission on which the actor may run the action, locked against deletion until the run exists."""
    of_mission = (mission.c.id, mission.c.name, mission.c.project_id)
    columns = (*of_mission, project.c.isolation, level_on_mission(actor).label("level"))
    stmt = visible_missions(actor).with_only_columns(*columns, maintain_column_froms=True)
    locked = stmt.where(mission.c.id == mission_id).with_for_update(read=True, key_share=True, of=[mission, project])
    row = (await db.execute(locked)).one_or_none()
    if row is None:
        raise NotFound(resource_type="mission", ref=str(mission_id))
    target = TargetMission._make(row)._replace(isolation=Isolation(row.isolation))
    needed = max(Right.create, task.definition.right, key=lambda right: right.level)
    if target.level < needed.level:
        raise Forbidden(resource_type="mission", operation=f"run {task.definition.name} on it", needs=needed.value)
    if task.priority is RunPriority.high and target.level < Right.delete.level:
        raise Forbidden(resource_type="mission", operation="run with high priority on it", needs=Right.delete.value)
    if task.project_id not in {None, target.project_id}:
        message = (
            f"{task.definition.name} is an action of another project; publish it in this one, or for the whole lab"
        )
        raise InvalidRequest(problems=[FieldProblem(field="action_id", message=message)])
    return target


async def _find_inputs(
    db: Connection, actor: Actor, definition: ActionDefinition, target: TargetMission
) -> list[Input]:
    requested = definition.inputs
    is_derived = file.c.origin == DERIVED_ORIGIN
    matching = FileFilter(
        mission_id=target.id, path=requested.paths, topic=requested.topics, message_type=requested.message_types
    )
    columns = (file.c.id, file.c.path, file.c.blob_id, blob.c.size_bytes, blob.c.sha256, blob.c.state, is_derived)
    stmt = filter_files(actor, visible_files(actor), matching).with_only_columns(*columns, maintain_column_froms=True)
    if not requested.derived:
        stmt = stmt.where(file.c.origin != DERIVED_ORIGIN)
    inputs = [Input._make(row) for row in await db.execute(stmt.order_by(file.c.path))]
    if not inputs:
        chosen = requested.model_dump(include={"paths", "topics", "message_types"})
        parts = [f"{name} {', '.join(globs)}" for name, globs in chosen.items() if globs]
        details = " and ".join(parts).replace("_", " ") or "any file"
        if not requested.derived:
            details += " (files that runs made are inputs only with `derived: true`)"
        raise NoInputs(mission=target.name, action=definition.name, inputs=details)
    for entry in inputs:
        if entry.state in service.UNREADABLE:
            raise FileUnavailable(path=entry.path, state=entry.state)
        if entry.path.partition("/")[0] in _RESERVED:
            message = f"the file {entry.path!r} has a name that runners use in /in; rename it"
            raise InvalidRequest(problems=[FieldProblem(field="mission_ids", message=message)])
    return inputs


class HashedFile(Protocol):
    """The path and the bytes of an input."""

    @property
    def path(self) -> str:
        """Path in the mission."""

    @property
    def sha256(self) -> bytes:
        """SHA-256 of the bytes."""


def inputs_fingerprint(
    version_id: uuid.UUID, parameters: ParameterValues, inputs: Iterable[HashedFile], declared: DeclaredInputs
) -> bytes:
    """Return the hash of everything that determines the results, except the image; inputs are in order of paths."""
    parts: list[object] = [str(version_id), parameters, [[entry.path, entry.sha256.hex()] for entry in inputs]]
    if declared.decisive is not None:  # results of actions that declare nothing stay valid
        parts.append(declared.decisive)
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).digest()


async def _reusable_results(
    db: Connection, task: PreparedAction, mission_id: uuid.UUID, fingerprint: bytes
) -> dict[str, Any] | None:
    """Return the columns of a run that reuses the latest run with this fingerprint, mission and image."""
    images = {task.image_digest} - {None}
    if task.definition.image is None:
        images = {known.default_image for known in task.runners.runners if known.is_alive}
    same_image = or_(false(), *(run.c.image_digest.is_not_distinct_from(entry) for entry in images))
    good = (run.c.inputs_fingerprint == fingerprint) & (run.c.state == RunState.done.value) & run.c.reuses_id.is_(None)
    good &= ~run.c.is_recorded
    columns = (run.c.id.label("reuses_id"), *(run.c[name] for name in _REUSED_COLUMNS))
    stmt = select(*columns).where(good, run.c.mission_id == mission_id, same_image)
    earlier = (await db.execute(stmt.order_by(run.c.ended_at.desc()).limit(1))).mappings().one_or_none()
    if earlier is None:
        return None
    return {
        **earlier,
        "state": RunState.done.value,
        "reason": EndReason.done.value,
        "message": "It was run before with the same inputs and parameters; those results are reused.",
        "ended_at": func.now(),
    }
