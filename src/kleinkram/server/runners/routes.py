"""Routes of runners."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query, Request

from kleinkram.contract import runners
from kleinkram.contract.base import Page
from kleinkram.contract.runs import RunContext
from kleinkram.contract.uploads import UploadDecisions
from kleinkram.server.http.dependencies import CurrentActor, CurrentContext, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.middleware import mark_as_stream
from kleinkram.server.pagination import PageQuery
from kleinkram.server.runners import assigned_runs, ends, service
from kleinkram.server.runners.claims import claim
from kleinkram.server.runners.contexts import get_context, get_contexts
from kleinkram.server.runners.heartbeats import record_heartbeats

router = APIRouter(prefix="/api/v1", tags=["runners"], responses=FAILURE_RESPONSES)
AttemptQuery = Annotated[runners.Attempt, Query()]


@router.get("/runners", operation_id="list_runners")
async def list_runners(
    query: Annotated[PageQuery, Query()], db: Transaction, _actor: CurrentActor
) -> Page[runners.RunnerRead]:
    """List runners by name."""
    return await service.list_runners(db, page=query.page)


@router.post("/runners", operation_id="register_runner")
async def register_runner(
    registration: runners.RunnerRegistration, db: Transaction, actor: CurrentActor
) -> runners.RunnerRead:
    """Register a runner, or update its description."""
    return await service.register_runner(db, actor, registration=registration)


@router.post("/runners/{runner_id}/claims", operation_id="claim_run")
async def claim_run(
    runner_id: uuid.UUID,
    requested: runners.ClaimRequest,
    request: Request,
    context: CurrentContext,
    actor: CurrentActor,
) -> runners.ClaimReply:
    """Claim a run that fits the free resources; wait for one."""
    mark_as_stream(request.scope)
    return await claim(context, request.app.state.hub, actor, runner_id=runner_id, requested=requested)


@router.post("/runners/{runner_id}/heartbeats", operation_id="send_heartbeats")
async def send_heartbeats(
    runner_id: uuid.UUID, heartbeats: runners.Heartbeats, db: Transaction, actor: CurrentActor
) -> runners.HeartbeatReplies:
    """Report the states of all runs, and renew their leases."""
    return await record_heartbeats(db, actor, runner_id=runner_id, heartbeats=heartbeats)


@router.post("/runners/{runner_id}/contexts", operation_id="get_run_contexts")
async def get_run_contexts(
    runner_id: uuid.UUID, requested: runners.ContextsRequest, db: Transaction, actor: CurrentActor
) -> runners.RunContexts:
    """Get the contents of `/in/mission.json` of several runs."""
    return await get_contexts(db, actor, runner_id=runner_id, requested=requested.runs)


@router.get("/runner/runs/{run_id}/context", operation_id="get_run_context")
async def get_run_context(run_id: uuid.UUID, attempt: AttemptQuery, db: Transaction, actor: CurrentActor) -> RunContext:
    """Get the content of `/in/mission.json`."""
    return await get_context(db, actor, run_id=run_id, attempt=attempt)


@router.post("/runner/runs/{run_id}/inputs", operation_id="sign_inputs")
async def sign_inputs(
    run_id: uuid.UUID, requested: runners.InputsRequest, context: CurrentContext, actor: CurrentActor
) -> runners.InputUrls:
    """Get URLs of inputs."""
    return await assigned_runs.sign_inputs(context, actor, run_id=run_id, requested=requested)


@router.post("/runner/runs/{run_id}/log-chunks", operation_id="create_log_chunk")
async def create_log_chunk(
    run_id: uuid.UUID, requested: runners.LogChunkCreate, context: CurrentContext, actor: CurrentActor
) -> runners.LogChunkUpload:
    """Get a URL to upload a chunk of the log to."""
    return await assigned_runs.create_log_chunk(context, actor, run_id=run_id, requested=requested)


@router.post("/runner/runs/{run_id}/log-chunks/confirm", operation_id="confirm_log_chunk", status_code=204)
async def confirm_log_chunk(
    run_id: uuid.UUID, confirmed: runners.LogChunkConfirm, db: Transaction, actor: CurrentActor
) -> None:
    """Confirm that a chunk of the log was uploaded; it becomes visible."""
    await assigned_runs.confirm_log_chunk(db, actor, run_id=run_id, confirmed=confirmed)


@router.post("/runner/runs/{run_id}/uploads", operation_id="create_artifact_uploads")
async def create_artifact_uploads(
    run_id: uuid.UUID, requested: runners.ArtifactUploadsCreate, context: CurrentContext, actor: CurrentActor
) -> UploadDecisions:
    """Start uploads of artifacts, by the same protocol as files of a mission."""
    return await assigned_runs.create_artifact_uploads(context, actor, run_id=run_id, requested=requested)


@router.post("/runner/runs/{run_id}/finish", operation_id="finish_run")
async def finish_run(
    run_id: uuid.UUID, finish: runners.RunFinish, context: CurrentContext, actor: CurrentActor
) -> runners.RunFinished:
    """Report the end of a run, once its artifacts are uploaded."""
    return await ends.finish_run(context, actor, run_id=run_id, finish=finish)


@router.post("/runners/{runner_id}/ends", operation_id="finish_runs")
async def finish_runs(
    runner_id: uuid.UUID, reported: runners.RunEnds, context: CurrentContext, actor: CurrentActor
) -> runners.RunEndsRecorded:
    """Report the ends of several runs, once their artifacts are uploaded."""
    return await ends.finish_runs(context, actor, runner_id=runner_id, reported=reported.ends)
