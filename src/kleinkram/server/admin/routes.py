"""Routes for admins of the server."""

from typing import Annotated

from fastapi import APIRouter, Path, Request

from kleinkram.contract import admin
from kleinkram.server.admin import service
from kleinkram.server.admin.status import get_status
from kleinkram.server.http.dependencies import CurrentActor, CurrentContext, CurrentSettings, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES

router = APIRouter(prefix="/api/v1/admin", tags=["admin"], responses=FAILURE_RESPONSES)
JobId = Annotated[int, Path(ge=1, le=2**63 - 1)]


@router.get("/storage", operation_id="get_admin_storage")
async def get_admin_storage(db: Transaction, settings: CurrentSettings) -> admin.AdminStorage:
    """Return the contents of the store by state, and the free space if known."""
    return await service.get_storage(db, settings)


@router.get("/jobs", operation_id="get_admin_jobs")
async def get_admin_jobs(db: Transaction) -> admin.AdminJobs:
    """Return the queue, the jobs that wait for another attempt, and failed jobs."""
    return await service.get_jobs(db)


@router.post("/jobs/{job_id}/retry", operation_id="retry_job", status_code=204)
async def retry_job(job_id: JobId, db: Transaction, actor: CurrentActor) -> None:
    """Requeue a failed job."""
    await service.retry_job(db, actor, job_id)


@router.post("/jobs/retry", operation_id="retry_jobs")
async def retry_jobs(db: Transaction, actor: CurrentActor) -> admin.RetriedJobs:
    """Requeue all failed jobs."""
    return await service.retry_jobs(db, actor)


@router.get("/scrub", operation_id="get_admin_scrub")
async def get_admin_scrub(db: Transaction, settings: CurrentSettings) -> admin.ScrubState:
    """Return the last comparison of the store with the database."""
    return await service.get_scrub(db, settings)


@router.post("/scrub", operation_id="begin_scrub", status_code=202)
async def begin_scrub(
    request: admin.ScrubRequest, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> admin.ScrubRead:
    """Start a comparison of the store with the database."""
    return await service.begin_scrub(db, actor, settings, accept_losses=request.accept_losses)


@router.get("/health", operation_id="get_admin_health")
async def get_admin_health(http_request: Request, context: CurrentContext, _actor: CurrentActor) -> admin.AdminHealth:
    """Return the state of database, store and workers."""
    return await service.get_health(context, takes_pages=http_request.app.state.pages_may_send)


@router.get("/status", operation_id="get_admin_status")
async def get_admin_status(http_request: Request, context: CurrentContext, _actor: CurrentActor) -> admin.AdminStatus:
    """Return whether the server is healthy, what is full and when, and what needs an admin."""
    return await get_status(context, takes_pages=http_request.app.state.pages_may_send)


@router.get("/settings", operation_id="get_admin_settings")
async def get_admin_settings(settings: CurrentSettings, _actor: CurrentActor) -> admin.AdminSettings:
    """Return the settings in force, without secrets."""
    return service.get_settings(settings)
