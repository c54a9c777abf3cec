"""Runs that were executed elsewhere, recorded with their results: by pipelines, batch jobs and notebooks.

Their metrics, findings and lineage are those of any run. Nothing of them was observed by this server, which they say.
"""

import datetime
import uuid
from collections.abc import Sequence

from sqlalchemy import func, insert, select, update

from kleinkram.contract.actions import ActionDefinition, Network
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.errors import FieldProblem, InvalidRequest, NotFound
from kleinkram.contract.isolation import Isolation
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.reports import verdict_of_report
from kleinkram.contract.runs import EndReason, RunRead, RunRecord, RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_mission
from kleinkram.server.access.visible import visible_files
from kleinkram.server.actions import service as actions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, among
from kleinkram.server.jobs.rejudge import judge_again_for_runs
from kleinkram.server.missions import service as missions
from kleinkram.server.quotas import project_of
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.runs import service
from kleinkram.server.runs.declared_inputs import DeclaredInputs
from kleinkram.server.runs.launch import Input, inputs_fingerprint, store_inputs
from kleinkram.server.runs.lifecycle import report_columns, store_reports
from kleinkram.server.tables import DERIVED_ORIGIN, blob, file, run, run_artifact


async def record_run(db: Connection, actor: Actor, *, requested: RunRecord, weakest: Isolation) -> RunRead:
    """Record a run that was executed elsewhere, and return it; its outputs become files that it made. Idempotent.

    Raises:
        NotFound: the mission, or one of the files, is not there, or not for this actor.
        Forbidden: the actor may not add to the mission.
        InvalidRequest: an output was uploaded by somebody else, or made by another run.
    """
    mission_id = requested.mission_id
    await require_mission(db, actor, "record_run", mission_id)
    await missions.lock_mission_to_fill(db, actor, mission_id)
    inputs = await _find_files(db, actor, mission_id, requested.inputs)
    outputs = await _find_files(db, actor, mission_id, requested.outputs)
    definition = ActionDefinition(name=requested.name, script=requested.script, network=Network.open)
    version_id = (await actions.store_unpublished(db, actor, definition, is_locked_here=False)).id
    fingerprint = inputs_fingerprint(
        version_id, requested.parameters, [*inputs, *outputs], DeclaredInputs(decisive=["recorded"])
    )
    same = (run.c.inputs_fingerprint == fingerprint) & run.c.is_recorded & (run.c.mission_id == mission_id)
    known_id: uuid.UUID | None = (await db.execute(select(run.c.id).where(same).limit(1))).scalar_one_or_none()
    if known_id is not None:
        return await service.get_run(db, actor, known_id, weakest=weakest)
    await _check_outputs(db, actor, outputs)
    run_id, project_id = uuid.uuid4(), await project_of(db, mission_id)
    needed = definition.resources
    started = None if requested.duration_s is None else func.now() - datetime.timedelta(seconds=requested.duration_s)
    verdict = verdict_of_report(requested.report)
    values = {
        "mission_id": mission_id,
        "launch_project_id": project_id,
        "version_id": version_id,
        "parameters": requested.parameters,
        "network": definition.network.value,
        "cores": needed.cores,
        "memory_bytes": needed.memory_bytes,
        "disk_bytes": needed.disk_bytes,
        "gpus": needed.gpus,
        "needs_images": False,
        "state": RunState.done.value,
        "reason": EndReason.done.value,
        "message": f"It was executed elsewhere, and recorded by {actor.name}.",
        "inputs_fingerprint": fingerprint,
        "is_recorded": True,
        "started_by_id": actor.person_id,
        "input_count": len(inputs),
        "input_bytes": sum(entry.size_bytes for entry in inputs),
        "artifact_count": len(outputs),
        "verdict": verdict and verdict.value,
        "started_at": started,
        "ended_at": func.now(),
    }
    await db.execute(insert(run).values(id=run_id, **values))
    await db.execute(update(run).where(run.c.id == run_id).values(report_columns(requested.report)))
    await store_reports(db, {run_id: requested.report})
    await _store_files(db, run_id, inputs, outputs)
    if outputs:
        await derive_again(db, mission_id)
    await judge_again_for_runs(db, [run_id])
    await publish(db, [ChangeEvent("run", ChangeKind.created, run_id, mission_id=mission_id)])
    after: Metadata = {"version_id": str(version_id), "files": len(inputs), "artifacts": len(outputs)}
    event = Event("run.record", "run", run_id, requested.name, project_id, after=after, mission_id=mission_id)
    await audit(db, actor, event)
    return await service.get_run(db, actor, run_id, weakest=weakest)


async def _find_files(db: Connection, actor: Actor, mission_id: uuid.UUID, paths: Sequence[str]) -> list[Input]:
    is_derived = file.c.origin == DERIVED_ORIGIN
    columns = (file.c.id, file.c.path, file.c.blob_id, blob.c.size_bytes, blob.c.sha256, blob.c.state, is_derived)
    stmt = visible_files(actor).with_only_columns(*columns, maintain_column_froms=True)
    selected = stmt.where(file.c.mission_id == mission_id, among(file.c.path, paths)).order_by(file.c.path)
    inputs = [Input._make(row) for row in await db.execute(selected)]
    if missing := sorted({*paths} - {entry.path for entry in inputs}):
        raise NotFound(resource_type="file", ref=missing[0])
    return inputs


async def _check_outputs(db: Connection, actor: Actor, outputs: Sequence[Input]) -> None:
    uploaders = select(file.c.path).where(among(file.c.id, [entry.id for entry in outputs]))
    others = uploaders.where(file.c.uploaded_by_id != actor.person_id).order_by(file.c.path)
    message = None
    if derived := [entry.path for entry in outputs if entry.is_derived]:
        message = f"{derived[0]} was made by another run; upload the result under another name"
    elif (other := (await db.execute(others.limit(1))).scalar_one_or_none()) is not None:
        message = f"{other} was uploaded by another person; outputs are files that you uploaded"
    if message is not None:
        raise InvalidRequest(problems=[FieldProblem(field="outputs", message=message)])


async def _store_files(db: Connection, run_id: uuid.UUID, inputs: Sequence[Input], outputs: Sequence[Input]) -> None:
    await store_inputs(db, run_id, inputs)
    if outputs:
        made = [
            {
                "id": uuid.uuid4(),
                "run_id": run_id,
                "path": entry.path,
                "blob_id": entry.blob_id,
                "file_id": entry.id,
                "derived_from": [],
            }
            for entry in outputs
        ]
        await db.execute(insert(run_artifact), made)
        made_ids = [entry.id for entry in outputs]
        await db.execute(update(file).where(among(file.c.id, made_ids)).values(origin=DERIVED_ORIGIN))
