"""Routes of checks: the `checks.yaml` of projects, and the checks of missions."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import Field

from kleinkram.contract.base import Page
from kleinkram.contract.checks import (
    CheckAcceptanceCreate,
    CheckAcceptanceRead,
    CheckMatrix,
    CheckNoteCreate,
    CheckNoteRead,
    CheckReportCreate,
    CheckReportRead,
    ChecksVersionRead,
    CheckTrend,
    MissionCheckFilter,
    MissionChecksRead,
    ProjectChecksRead,
    ProjectChecksUpdate,
    TrendStep,
)
from kleinkram.server.checks import documents, overview, service
from kleinkram.server.http.dependencies import CurrentActor, Reading, Transaction, VersionNumber
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import IfMatch
from kleinkram.server.pagination import CountedPageQuery, PageQuery

router = APIRouter(prefix="/api/v1", tags=["checks"], responses=FAILURE_RESPONSES)


class MissionChecksQuery(MissionCheckFilter, PageQuery):
    """The query of the checks of a mission."""

    with_history: bool = Field(False, alias="all")


@router.get("/projects/{project_id}/checks", operation_id="get_project_checks")
async def get_project_checks(project_id: uuid.UUID, db: Reading, actor: CurrentActor) -> ProjectChecksRead:
    """Return the `checks.yaml` of a project."""
    return await documents.get_project_checks(db, actor, project_id)


@router.put("/projects/{project_id}/checks", operation_id="set_project_checks")
async def set_project_checks(
    project_id: uuid.UUID, new: ProjectChecksUpdate, db: Transaction, actor: CurrentActor, if_match: IfMatch = None
) -> ProjectChecksRead:
    """Set the `checks.yaml` of a project and judge its missions by it; an empty text removes it."""
    return await documents.set_project_checks(db, actor, project_id=project_id, text=new.text, if_match=if_match)


@router.get("/projects/{project_id}/checks/versions", operation_id="list_checks_versions")
async def list_checks_versions(
    project_id: uuid.UUID, query: Annotated[PageQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[ChecksVersionRead]:
    """List the versions of a project's `checks.yaml`, latest first."""
    return await documents.list_versions(db, actor, project_id=project_id, page=query.page)


@router.get("/projects/{project_id}/checks/versions/{number}", operation_id="get_checks_version")
async def get_checks_version(
    project_id: uuid.UUID, number: VersionNumber, db: Reading, actor: CurrentActor
) -> ProjectChecksRead:
    """Return one version of a project's `checks.yaml`."""
    return await documents.get_version(db, actor, project_id=project_id, number=number)


@router.get("/projects/{project_id}/checks/matrix", operation_id="get_check_matrix")
async def get_check_matrix(
    project_id: uuid.UUID, query: Annotated[CountedPageQuery, Query()], db: Reading, actor: CurrentActor
) -> CheckMatrix:
    """Return a page of a project's missions, latest first, with the worst status of each check."""
    return await overview.get_matrix(db, actor, project_id=project_id, page=query.page)


@router.get("/projects/{project_id}/checks/trend", operation_id="get_check_trend")
async def get_check_trend(
    project_id: uuid.UUID, db: Reading, actor: CurrentActor, by: TrendStep = TrendStep.week
) -> CheckTrend:
    """Return the verdicts of a project's missions by the day or week of their recordings."""
    return await overview.get_trend(db, actor, project_id=project_id, by=by)


@router.get("/missions/{mission_id}/checks", operation_id="get_mission_checks")
async def get_mission_checks(
    mission_id: uuid.UUID, query: Annotated[MissionChecksQuery, Query()], db: Reading, actor: CurrentActor
) -> MissionChecksRead:
    """Return a page of the checks of a mission and its verdict; with `all`, also what no longer counts."""
    return await service.get_mission_checks(
        db, actor, mission_id=mission_id, matching=query, page=query.page, with_history=query.with_history
    )


@router.post("/missions/{mission_id}/check-reports", operation_id="create_check_report", status_code=201)
async def create_check_report(
    mission_id: uuid.UUID, report: CheckReportCreate, db: Transaction, actor: CurrentActor
) -> CheckReportRead:
    """Store the checks that an uploader made of a mission's files."""
    return await service.create_report(db, actor, mission_id=mission_id, report=report)


@router.post("/missions/{mission_id}/check-acceptances", operation_id="accept_check", status_code=201)
async def accept_check(
    mission_id: uuid.UUID, accepted: CheckAcceptanceCreate, db: Transaction, actor: CurrentActor
) -> CheckAcceptanceRead:
    """Accept that a check fails, until the mission's files change."""
    return await service.accept_check(db, actor, mission_id=mission_id, accepted=accepted)


@router.delete("/missions/{mission_id}/check-acceptances/{acceptance_id}", operation_id="withdraw_acceptance")
async def withdraw_acceptance(
    mission_id: uuid.UUID, acceptance_id: uuid.UUID, db: Transaction, actor: CurrentActor
) -> CheckAcceptanceRead:
    """Withdraw an acceptance: the check counts again."""
    return await service.withdraw_acceptance(db, actor, mission_id=mission_id, acceptance_id=acceptance_id)


@router.post("/missions/{mission_id}/check-notes", operation_id="create_check_note", status_code=201)
async def create_check_note(
    mission_id: uuid.UUID, note: CheckNoteCreate, db: Transaction, actor: CurrentActor
) -> CheckNoteRead:
    """Add a note to a check of a mission."""
    return await service.create_note(db, actor, mission_id=mission_id, note=note)


@router.delete("/missions/{mission_id}/check-notes/{note_id}", operation_id="delete_check_note", status_code=204)
async def delete_check_note(mission_id: uuid.UUID, note_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Delete a note."""
    await service.delete_note(db, actor, mission_id=mission_id, note_id=note_id)
