"""Routes of projects."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.base import Page
from kleinkram.contract.missions import MissionTemplate
from kleinkram.contract.names import Term
from kleinkram.contract.projects import Deleted, ProjectCreate, ProjectRead, ProjectSort, ProjectUpdate
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Reading, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import IfMatch
from kleinkram.server.pagination import CountedPageQuery
from kleinkram.server.projects import service

router = APIRouter(prefix="/api/v1/projects", tags=["projects"], responses=FAILURE_RESPONSES)


class ProjectListQuery(CountedPageQuery):
    """Query parameters of the list of projects. `name` may be a glob; `text` is searched in names and descriptions."""

    name: Term | None = None
    text: Term | None = None
    sort: ProjectSort = ProjectSort.name


@router.get("", operation_id="list_projects")
async def list_projects(
    query: Annotated[ProjectListQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[ProjectRead]:
    """List the projects that match."""
    return await service.list_projects(db, actor, name=query.name, text=query.text, sort=query.sort, page=query.page)


@router.post("", operation_id="create_project", status_code=201)
async def create_project(
    request: ProjectCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> ProjectRead:
    """Create a project."""
    return await service.create_project(db, actor, request=request, creators=settings.creators)


@router.get("/{project_id}", operation_id="get_project")
async def get_project(project_id: uuid.UUID, db: Reading, actor: CurrentActor) -> ProjectRead:
    """Return one project."""
    return await service.get_project(db, actor, project_id)


@router.patch("/{project_id}", operation_id="update_project")
async def update_project(
    project_id: uuid.UUID,
    changes: ProjectUpdate,
    db: Transaction,
    actor: CurrentActor,
    settings: CurrentSettings,
    if_match: IfMatch = None,
) -> ProjectRead:
    """Rename or describe a project, or change its metadata fields; omitted fields stay."""
    weakest = settings.weakest_isolation
    return await service.update_project(
        db, actor, project_id=project_id, changes=changes, weakest=weakest, if_match=if_match
    )


@router.delete("/{project_id}", operation_id="delete_project")
async def delete_project(project_id: uuid.UUID, db: Transaction, actor: CurrentActor, dry_run: bool = False) -> Deleted:
    """Move a project and everything in it to the trash."""
    return await service.delete_project(db, actor, project_id=project_id, dry_run=dry_run)


@router.get("/{project_id}/template", operation_id="get_mission_template")
async def get_mission_template(project_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> MissionTemplate:
    """Return the form for the project's next mission, also as YAML."""
    return await service.get_template(db, actor, project_id)
