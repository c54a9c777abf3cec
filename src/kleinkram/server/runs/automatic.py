"""Starts the actions that a project names on the missions that are due: each version once on the same inputs.

The decision, its run, and the row that makes it happen once are one transaction: it may be repeated at any time, and by
several workers.

Of the files that runs made, an action that reads derived files depends on those of actions that read none, such as a
trajectory that it evaluates: it waits for their runs, and runs again when they add a file. All others start nothing, so
that actions cannot start each other in a circle.
"""

import datetime
import uuid
from collections.abc import AsyncIterator, Sequence
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Row, Select, Text, and_, case, cast, exists, false, func, or_, select, text, true
from sqlalchemy.dialects.postgresql import insert as upsert

from kleinkram.contract.actions import ActionDefinition, Network, ParametersWrong
from kleinkram.contract.errors import Forbidden, KleinkramError, NoInputs, NotFound
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.project_actions import RunTrigger
from kleinkram.contract.runs import RunPriority
from kleinkram.server.access.actor import Actor, find_person
from kleinkram.server.actions import service as actions
from kleinkram.server.db import Connection, among
from kleinkram.server.jobs.queue import Job, Priority, enqueue, has_job
from kleinkram.server.jobs.rejudge import judge_again
from kleinkram.server.missions import service as missions
from kleinkram.server.missions.queries import AWAITS_READING
from kleinkram.server.runs import launch
from kleinkram.server.runs.eligibility import known_runners
from kleinkram.server.tables import (
    DERIVED_ORIGIN,
    action,
    action_version,
    automatic_run,
    blob,
    file,
    mission,
    person,
    project,
    project_action,
    project_action_mission,
    run,
    run_artifact,
    upload,
)
from kleinkram.server.tables.blobs import UNDER_WAY
from kleinkram.server.tables.runs import ACTIVE

# After a problem that time or a person may remove, such as a missing runner or right.
_RETRY_AFTER = datetime.timedelta(minutes=10)
_BATCH = 200


class _Decision(NamedTuple):
    problem: str | None = None
    is_final: bool = True


async def enqueue_automatic_runs(
    db: Connection, *, mission_id: uuid.UUID | None = None, project_id: uuid.UUID | None = None
) -> None:
    """Enqueue a job for each mission on which an action is due: of all missions, of one, or of a project."""
    stmt = _due_actions().with_only_columns(cast(mission.c.id, Text)).distinct().limit(_BATCH)
    stmt = stmt.where(~has_job(Job.start_automatic_runs, mission.c.id))
    if mission_id is not None:
        stmt = stmt.where(mission.c.id == mission_id)
    if project_id is not None:
        stmt = stmt.where(mission.c.project_id == project_id)
    ids = (await db.execute(stmt)).scalars().all()
    await enqueue(db, Job.start_automatic_runs, ids=ids, priority=Priority.normal)


async def start_due_runs(db: Connection, mission_id: uuid.UUID, *, weakest: Isolation) -> None:
    """Start the actions that are due on a mission, in the caller's transaction, which locks the mission.

    `weakest` is the setting `weakest_isolation`.
    """
    if not await missions.lock_mission(db, mission_id):
        return
    async for row in _due_on(db, mission_id):
        decision = await _decide(db, row, weakest)
        retry_at = None if decision.is_final else func.now() + _RETRY_AFTER
        values = {
            "files_revision": row.files_revision,
            "checks_number": row.checks_number,
            "problem": decision.problem,
            "retry_at": retry_at,
            "decided_at": func.now(),
        }
        stmt = upsert(project_action_mission).values(project_action_id=row.id, mission_id=mission_id, **values)
        keys = ["project_action_id", "mission_id"]
        await db.execute(stmt.on_conflict_do_update(index_elements=keys, set_=values))
        if decision.problem != row.problem:
            await judge_again(db, [mission_id])


async def _decide(db: Connection, row: Row[Any], weakest: Isolation) -> _Decision:
    adder = await find_person(db, row.added_by_id)
    if adder is None:
        return _Decision(f"{row.added_by_name}, who added {row.name}, has no account any more", is_final=False)
    if (excess := await _excess(db, row)) is not None:
        return _Decision(excess, is_final=False)
    actor = adder.for_request("create_runs", request_id=None, address=None)
    try:
        # A failure leaves nothing behind but the decision.
        async with db.begin_nested():
            await _start_once(db, actor, row, weakest)
    except (NotFound, Forbidden) as error:
        return _Decision(f"{row.added_by_name}, who added {row.name}, may not run it here: {error}", is_final=False)
    except (NoInputs, ParametersWrong) as error:
        return _Decision(str(error))
    except KleinkramError as error:
        return _Decision(str(error), is_final=False)
    return _Decision()


async def _start_once(db: Connection, actor: Actor, row: Row[Any], weakest: Isolation) -> None:
    version = await actions.get_version_to_run(db, actor, action_id=row.action_id, number=None)
    parameters = version.definition.fill_in(row.parameters)
    of_project = select(action.c.project_id).where(action.c.id == row.action_id)
    project_id: uuid.UUID | None = (await db.execute(of_project)).scalar_one()
    # Nobody waits for it at a screen.
    priority, runners = RunPriority.low, await known_runners(db, weakest)
    task = launch.PreparedAction(
        version.id, version.definition, version.image_digest, project_id, parameters, priority, runners
    )
    planned = await launch.plan_run(db, actor, task, row.mission_id)
    made = await _of_actions_that_read_none(db, [entry.id for entry in planned.inputs if entry.is_derived])
    decisive = [entry for entry in planned.inputs if not entry.is_derived or entry.id in made]
    key = {
        "mission_id": row.mission_id,
        "version_id": version.id,
        "inputs_sha256": launch.inputs_fingerprint(version.id, parameters, decisive, planned.declared),
    }
    started = upsert(automatic_run).values(**key).on_conflict_do_nothing().returning(automatic_run.c.mission_id)
    if (await db.execute(started)).first() is None:
        return
    started_run = await launch.start_run(db, actor, task, planned, force=False)
    own = and_(*(automatic_run.c[name] == value for name, value in key.items()))
    await db.execute(automatic_run.update().where(own).values(run_id=started_run.id))


async def _of_actions_that_read_none(db: Connection, file_ids: Sequence[uuid.UUID]) -> set[uuid.UUID]:
    """Return which of these files were made by actions that read no derived files."""
    stmt = select(run_artifact.c.file_id).join(run, run.c.id == run_artifact.c.run_id)
    stmt = stmt.join(action_version, action_version.c.id == run.c.version_id)
    return {*(await db.execute(stmt.where(among(run_artifact.c.file_id, file_ids), ~_declares("derived")))).scalars()}


async def _excess(db: Connection, row: Row[Any]) -> str | None:
    """Return what the latest version of an action asks for beyond the one that was the latest when it was added.

    Its author may be somebody else, and runs act with the rights of who added it.
    """
    versions = select(action_version.c.number, action_version.c.definition)
    versions = versions.where(action_version.c.action_id == row.action_id).order_by(action_version.c.number.desc())
    was_there = or_(action_version.c.created_at <= row.created_at, action_version.c.number == 1)
    latest = (await db.execute(versions.limit(1))).one()
    known = (await db.execute(versions.where(was_there).limit(1))).one()
    new, old = (ActionDefinition.model_validate(version.definition) for version in (latest, known))
    networks = [*Network]
    if new.right.level <= old.right.level and networks.index(new.network) <= networks.index(old.network):
        return None
    required, added = (f"{one.right.value} and network: {one.network.value}" for one in (new, old))
    return (
        f"{row.name}@{latest.number} asks for {required}, but {row.added_by_name} added it with {added}; add it again"
    )


async def _due_on(db: Connection, mission_id: uuid.UUID) -> AsyncIterator[Row[Any]]:
    """Yield the actions that are due on a mission, those last that wait for runs of the others just started."""
    due = _due_actions().where(mission.c.id == mission_id).order_by(project_action.c.created_at, project_action.c.id)
    for reads_derived in (false(), true()):
        for row in (await db.execute(due.where(_latest_reads("derived") == reads_derived))).all():
            yield row


def _due_actions() -> Select[Any]:
    """Return the actions that are due on missions, joined with both, which nothing was decided of since a change.

    A mission is due once all of its files are read, and it was completed, or changed, after the action was added.
    """
    decided = project_action_mission
    names = ("id", "action_id", "added_by_id", "parameters", "created_at")
    stmt = (
        select(
            *(project_action.c[name] for name in names),
            action.c.name,
            person.c.name.label("added_by_name"),
            mission.c.id.label("mission_id"),
            mission.c.files_revision,
            project.c.checks_number,
            decided.c.problem,
        )
        .join_from(project_action, mission, mission.c.project_id == project_action.c.project_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(action, action.c.id == project_action.c.action_id)
        .join(person, person.c.id == project_action.c.added_by_id)
        .outerjoin(
            decided, (decided.c.project_action_id == project_action.c.id) & (decided.c.mission_id == mission.c.id)
        )
    )
    is_undecided = or_(
        decided.c.mission_id.is_(None),
        decided.c.files_revision != mission.c.files_revision,
        and_(decided.c.checks_number.is_distinct_from(project.c.checks_number), _latest_reads("checks", "reference")),
        decided.c.retry_at <= func.now(),
    )
    is_due = case(
        (project_action.c.trigger == RunTrigger.complete.value, mission.c.completed_at > project_action.c.created_at),
        else_=_is_idle(),
    )
    is_live = and_(mission.c.deleted_at.is_(None), project.c.deleted_at.is_(None), action.c.archived_at.is_(None))
    waits = _latest_reads("derived") & _has_active_source()
    return stmt.where(is_live, is_undecided, _is_read(), is_due, ~waits)


def _latest_reads(*names: str) -> ColumnElement[bool]:
    """Whether the latest version of an action reads what one of these fields of its inputs declares."""
    latest = select(or_(*map(_declares, names))).where(action_version.c.action_id == action.c.id)
    return latest.order_by(action_version.c.number.desc()).limit(1).correlate(action).scalar_subquery()


def _declares(name: str) -> ColumnElement[bool]:
    # Definitions that were stored before there was such a field do not have it.
    return func.coalesce(action_version.c.definition["inputs"][name].as_boolean(), false())


def _has_active_source() -> ColumnElement[bool]:
    """Whether a run on a mission has not ended, of an action that reads no derived files and may make one."""
    active = select(run.c.id).join(action_version, action_version.c.id == run.c.version_id)
    return active.where(run.c.mission_id == mission.c.id, run.c.state.in_(ACTIVE), ~_declares("derived")).exists()


def _is_read() -> ColumnElement[bool]:
    """Whether a mission has files, and all of them are read."""
    live = (file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None))
    recorded = exists().where(*live, file.c.origin != DERIVED_ORIGIN)
    unread = select(file.c.id).join(blob, blob.c.id == file.c.blob_id).where(*live, AWAITS_READING)
    is_derived = mission.c.derived_revision == mission.c.files_revision
    return and_(is_derived, recorded, ~unread.correlate(mission).exists())


def _is_idle() -> ColumnElement[bool]:
    """Whether the recorded files of a mission changed after the action was added, and not for its time."""
    own = (file.c.mission_id == mission.c.id, file.c.origin != DERIVED_ORIGIN)
    changed = func.max(func.greatest(file.c.created_at, func.coalesce(file.c.deleted_at, file.c.created_at)))
    changed_at = select(changed).where(*own).correlate(mission).scalar_subquery()
    uploads = exists().where(
        upload.c.mission_id == mission.c.id, upload.c.run_id.is_(None), upload.c.state.in_(UNDER_WAY)
    )
    rest = project_action.c.idle_s * text("interval '1 second'")
    return and_(changed_at > project_action.c.created_at, changed_at < func.now() - rest, ~uploads)
