"""Routes of runs."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, ConfigDict, Field

from kleinkram.contract import runs
from kleinkram.contract.base import Page
from kleinkram.contract.metrics import MetricNameFilter, MetricNames, MetricTableQuery, MetricTableRead
from kleinkram.contract.previews import MissionPictures, MissionPreviews, PicturesRequest
from kleinkram.contract.project_actions import ProjectActionAdd, ProjectActionList, ProjectActionRead
from kleinkram.server.http.dependencies import CurrentActor, CurrentContext, CurrentSettings, Reading, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.middleware import mark_as_stream
from kleinkram.server.pagination import CountedPageQuery, PageQuery
from kleinkram.server.runs import launch, lifecycle, logs, metric_tables, previews, project_actions, recorded, service

router = APIRouter(prefix="/api/v1", tags=["runs"], responses=FAILURE_RESPONSES)


class RunListQuery(runs.RunFilter, CountedPageQuery):
    """The query of a list of runs."""


class CheckListQuery(runs.CheckFilter, CountedPageQuery):
    """The query of a list of checks."""


class FindingListQuery(runs.FindingFilter, CountedPageQuery):
    """The query of a list of findings."""


class MetricListQuery(runs.MetricFilter, CountedPageQuery):
    """The query of a list of metrics."""


class LogQuery(BaseModel):
    """The offset of a chunk of a log, and how long to wait for it while the run lasts."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    offset: Annotated[int, Field(ge=0, lt=2**40)] = 0
    wait_s: Annotated[float, Field(ge=0, le=25)] = 0


@router.post("/runs", operation_id="create_runs")
async def create_runs(requested: runs.RunsCreate, context: CurrentContext, actor: CurrentActor) -> runs.RunsCreated:
    """Run an action on each of some missions, with an outcome for each."""
    return await launch.launch(context, actor, requested=requested)


@router.post("/runs/recorded", operation_id="record_run", status_code=201)
async def record_run(
    requested: runs.RunRecord, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> runs.RunRead:
    """Record a run that was executed elsewhere, with its results; recording the same again changes nothing."""
    return await recorded.record_run(db, actor, requested=requested, weakest=settings.weakest_isolation)


@router.get("/runs", operation_id="list_runs")
async def list_runs(
    query: Annotated[RunListQuery, Query()], db: Reading, actor: CurrentActor, settings: CurrentSettings
) -> Page[runs.RunRead]:
    """List runs, latest first."""
    weakest = settings.weakest_isolation
    return await service.list_runs(db, actor, matching=query, page=query.page, weakest=weakest)


@router.get("/runs/{run_id}", operation_id="get_run")
async def get_run(run_id: uuid.UUID, db: Reading, actor: CurrentActor, settings: CurrentSettings) -> runs.RunDetail:
    """Get a run with its details."""
    return await service.get_detail(db, actor, run_id, weakest=settings.weakest_isolation)


@router.post("/runs/{run_id}/cancel", operation_id="cancel_run")
async def cancel_run(
    run_id: uuid.UUID, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> runs.RunRead:
    """Cancel a run; a running one ends within seconds."""
    return await lifecycle.cancel_run(db, actor, run_id=run_id, weakest=settings.weakest_isolation)


@router.post("/runs/{run_id}/retry", operation_id="retry_run", status_code=201)
async def retry_run(
    run_id: uuid.UUID, db: Transaction, actor: CurrentActor, settings: CurrentSettings, force: bool = False
) -> runs.RunRead:
    """Launch the same action again, on the current files; with `force`, without reusing results."""
    return await launch.retry_run(db, actor, run_id=run_id, force=force, weakest=settings.weakest_isolation)


@router.get("/projects/{project_id}/actions", operation_id="list_project_actions")
async def list_project_actions(project_id: uuid.UUID, db: Reading, actor: CurrentActor) -> ProjectActionList:
    """List the actions that a project names: they run by themselves, and count for its verdicts."""
    return await project_actions.list_project_actions(db, actor, project_id=project_id)


@router.post("/projects/{project_id}/actions", operation_id="add_project_action", status_code=201)
async def add_project_action(
    project_id: uuid.UUID, requested: ProjectActionAdd, db: Transaction, actor: CurrentActor
) -> ProjectActionRead:
    """Have an action run by itself on the missions of a project that are due from now on."""
    return await project_actions.add_project_action(db, actor, project_id=project_id, requested=requested)


@router.delete("/projects/{project_id}/actions/{action_id}", operation_id="remove_project_action", status_code=204)
async def remove_project_action(
    project_id: uuid.UUID, action_id: uuid.UUID, db: Transaction, actor: CurrentActor
) -> None:
    """Stop an action from running by itself; its runs stay."""
    await project_actions.remove_project_action(db, actor, project_id=project_id, action_id=action_id)


@router.get("/runs/{run_id}/inputs", operation_id="list_run_inputs")
async def list_run_inputs(
    run_id: uuid.UUID, query: Annotated[PageQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[runs.RunInput]:
    """List the inputs of a run by path."""
    return await service.list_inputs(db, actor, run_id=run_id, page=query.page)


@router.get("/runs/{run_id}/artifacts", operation_id="list_artifacts")
async def list_artifacts(
    run_id: uuid.UUID, query: Annotated[PageQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[runs.ArtifactRead]:
    """List the artifacts of a run by path."""
    return await service.list_artifacts(db, actor, run_id=run_id, page=query.page)


@router.post("/runs/{run_id}/artifacts/download", operation_id="download_artifacts")
async def download_artifacts(
    run_id: uuid.UUID, requested: runs.ArtifactsRequest, context: CurrentContext, actor: CurrentActor
) -> runs.ArtifactUrls:
    """Return URLs of artifacts; the audit log records who requests them, and why."""
    items = await service.link_artifacts(context, actor, run_id=run_id, requested=requested)
    return runs.ArtifactUrls(items=items)


@router.get("/missions/{mission_id}/previews", operation_id="list_mission_previews")
async def list_mission_previews(mission_id: uuid.UUID, db: Reading, actor: CurrentActor) -> MissionPreviews:
    """List the pictures, tables and tracks that the latest run of each action shows of a mission."""
    return await previews.list_mission_previews(db, actor, mission_id=mission_id)


@router.post("/missions/pictures", operation_id="get_mission_pictures")
async def get_mission_pictures(
    requested: PicturesRequest, context: CurrentContext, actor: CurrentActor
) -> MissionPictures:
    """Return the first picture of each of some missions, for lists; the audit log records who views them."""
    return await previews.get_mission_pictures(context, actor, mission_ids=requested.mission_ids)


@router.get("/runs/{run_id}/log", operation_id="get_run_log")
async def get_run_log(
    run_id: uuid.UUID,
    query: Annotated[LogQuery, Query()],
    request: Request,
    context: CurrentContext,
    actor: CurrentActor,
) -> runs.LogChunkRead:
    """Get a chunk of the log of a run. The next one starts at `next_offset`, until `is_over`."""
    if query.wait_s:
        mark_as_stream(request.scope)
    hub = request.app.state.hub
    return await logs.read_log(context, hub, actor, run_id=run_id, offset=query.offset, wait_s=query.wait_s)


@router.get("/run-checks", operation_id="list_run_checks")
async def list_run_checks(
    query: Annotated[CheckListQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[runs.CheckRead]:
    """List the checks that runs reported: those of the latest run first, in the order of its report."""
    return await service.list_checks(db, actor, matching=query, page=query.page)


@router.get("/findings", operation_id="list_findings")
async def list_findings(
    query: Annotated[FindingListQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[runs.FindingRead]:
    """List findings: those of the latest run first, in the order of its report."""
    return await service.list_findings(db, actor, matching=query, page=query.page)


@router.get("/run-metrics", operation_id="list_run_metrics")
async def list_run_metrics(
    query: Annotated[MetricListQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[runs.MetricRead]:
    """List metrics: those of the latest run first, in the order of its report."""
    return await service.list_metrics(db, actor, matching=query, page=query.page)


@router.get("/metrics", operation_id="list_metrics")
async def list_metrics(query: Annotated[MetricNameFilter, Query()], db: Reading, actor: CurrentActor) -> MetricNames:
    """List the names of the metrics that runs reported."""
    return await metric_tables.list_metric_names(db, actor, matching=query)


@router.get("/metrics/table", operation_id="get_metric_table")
async def get_metric_table(
    query: Annotated[MetricTableQuery, Query()], db: Reading, actor: CurrentActor
) -> MetricTableRead:
    """Get a table of one metric: missions, or groups of them, by version, parameter, label or topic."""
    return await metric_tables.get_metric_table(db, actor, matching=query)


@router.get("/files/{file_id}/lineage", operation_id="get_lineage")
async def get_lineage(file_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> runs.LineageRead:
    """Get the run that produced a file and the runs that read it."""
    return await service.get_lineage(db, actor, file_id=file_id)
