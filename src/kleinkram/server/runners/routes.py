"""Runners over HTTP: they come by themselves, with a runner's token; nothing calls them."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query, Request

from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.contract.runners import (
    ArtifactsBegin,
    Attempt,
    BeatAnswers,
    Beats,
    ClaimAsk,
    Claimed,
    InputsAsk,
    InputUrls,
    RunFinish,
    RunFinished,
    RunnerHello,
    RunnerRead,
    SegmentAsk,
    SegmentKept,
    SegmentPut,
)
from kleinkram.contract.runs import RunContext
from kleinkram.contract.uploads import UploadDecisions
from kleinkram.server.dependencies import CurrentActor, CurrentSite, Transaction
from kleinkram.server.http import mark_as_stream
from kleinkram.server.pages import PageRequest
from kleinkram.server.runners import holding, service
from kleinkram.server.uploads.artifacts import begin_artifacts
from kleinkram.server.uploads.completion import finish_cut_off_artifacts

router = APIRouter(prefix="/api/v1", tags=["runners"])
AttemptQuery = Annotated[Attempt, Query()]


@router.get("/runners", operation_id="list_runners")
async def list_runners(
    db: Transaction,
    _actor: CurrentActor,
    limit: Annotated[PageSize, Query()] = 100,
    cursor: Cursor | None = None,
) -> Page[RunnerRead]:
    """List the runners, by name."""
    return await service.list_runners(db, page=PageRequest(limit, cursor))


@router.post("/runners", operation_id="say_hello")
async def say_hello(hello: RunnerHello, db: Transaction, actor: CurrentActor) -> RunnerRead:
    """Say what a runner is, whenever it starts."""
    return await service.say_hello(db, actor, hello=hello)


@router.post("/runners/{runner_id}/claims", operation_id="claim_run")
async def claim_run(
    runner_id: uuid.UUID, asked: ClaimAsk, request: Request, context: CurrentSite, actor: CurrentActor
) -> Claimed:
    """Ask for a run that fits what is free, and wait for one."""
    mark_as_stream(request.scope)
    return await service.claim(context, request.app.state.hub, actor, runner_id=runner_id, asked=asked)


@router.post("/runners/{runner_id}/beats", operation_id="beat")
async def beat(runner_id: uuid.UUID, said: Beats, db: Transaction, actor: CurrentActor) -> BeatAnswers:
    """Say what all runs are at, and hear which are to end."""
    return await service.take_beats(db, actor, runner_id=runner_id, said=said)


@router.get("/runner/runs/{run_id}/context", operation_id="get_run_context")
async def get_run_context(run_id: uuid.UUID, attempt: AttemptQuery, db: Transaction, actor: CurrentActor) -> RunContext:
    """Get what a run is told of itself, its mission and its files."""
    return await holding.get_context(db, actor, run_id=run_id, attempt=attempt)


@router.post("/runner/runs/{run_id}/inputs", operation_id="sign_inputs")
async def sign_inputs(run_id: uuid.UUID, asked: InputsAsk, context: CurrentSite, actor: CurrentActor) -> InputUrls:
    """Get where to read inputs."""
    return await holding.sign_inputs(context, actor, run_id=run_id, asked=asked)


@router.post("/runner/runs/{run_id}/log/sign", operation_id="sign_log_segment")
async def sign_log_segment(
    run_id: uuid.UUID, asked: SegmentAsk, context: CurrentSite, actor: CurrentActor
) -> SegmentPut:
    """Get where to store a piece of a log."""
    return await holding.sign_segment(context, actor, run_id=run_id, asked=asked)


@router.post("/runner/runs/{run_id}/log/kept", operation_id="keep_log_segment", status_code=204)
async def keep_log_segment(run_id: uuid.UUID, kept: SegmentKept, db: Transaction, actor: CurrentActor) -> None:
    """Say that a piece of a log was stored: people see it from then on."""
    await holding.keep_segment(db, actor, run_id=run_id, kept=kept)


@router.post("/runner/runs/{run_id}/uploads", operation_id="begin_artifacts")
async def begin_uploads_of_run(
    run_id: uuid.UUID, body: ArtifactsBegin, context: CurrentSite, actor: CurrentActor
) -> UploadDecisions:
    """Say what a run left, and hear what to send: by the same protocol as files of a mission."""
    async with context.database.begin() as db:
        row = await holding.hold(db, actor, run_id, body.attempt)
    await finish_cut_off_artifacts(context, actor, run_id=run_id, paths=[each.path for each in body.files])
    return UploadDecisions(items=await begin_artifacts(context, actor, row=row, wanted=body.files))


@router.post("/runner/runs/{run_id}/finish", operation_id="finish_run")
async def finish_run(run_id: uuid.UUID, said: RunFinish, db: Transaction, actor: CurrentActor) -> RunFinished:
    """Say how a run ended, once all that it left is uploaded."""
    return await holding.finish_run(db, actor, run_id=run_id, said=said)
