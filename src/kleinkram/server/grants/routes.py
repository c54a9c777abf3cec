"""Routes of grants and access, on projects and on missions."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.access import AccessRead, GrantCreate, GrantOn, GrantRead, GrantUpdate
from kleinkram.contract.base import Page
from kleinkram.server.grants import service
from kleinkram.server.grants.service import GrantResource
from kleinkram.server.http.dependencies import CurrentActor, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import PageQuery

router = APIRouter(prefix="/api/v1", tags=["access"], responses=FAILURE_RESPONSES)
ListQuery = Annotated[PageQuery, Query()]


@router.get("/projects/{project_id}/grants", operation_id="list_project_grants")
async def list_project_grants(
    project_id: uuid.UUID, query: ListQuery, db: Transaction, actor: CurrentActor
) -> Page[GrantRead]:
    """List the grants on a project, including expired ones, by the name of the grantee."""
    return await service.list_grants(db, actor, resource=GrantResource(GrantOn.project, project_id), page=query.page)


@router.get("/missions/{mission_id}/grants", operation_id="list_mission_grants")
async def list_mission_grants(
    mission_id: uuid.UUID, query: ListQuery, db: Transaction, actor: CurrentActor
) -> Page[GrantRead]:
    """List the grants on a mission itself."""
    return await service.list_grants(db, actor, resource=GrantResource(GrantOn.mission, mission_id), page=query.page)


@router.post("/projects/{project_id}/grants", operation_id="create_project_grant", status_code=201)
async def create_project_grant(
    project_id: uuid.UUID, request: GrantCreate, db: Transaction, actor: CurrentActor
) -> GrantRead:
    """Grant a right on a project and all its missions; it replaces the grantee's earlier one."""
    return await service.create_grant(db, actor, resource=GrantResource(GrantOn.project, project_id), request=request)


@router.post("/missions/{mission_id}/grants", operation_id="create_mission_grant", status_code=201)
async def create_mission_grant(
    mission_id: uuid.UUID, request: GrantCreate, db: Transaction, actor: CurrentActor
) -> GrantRead:
    """Grant a right on one mission; of the project, it shows only the name."""
    return await service.create_grant(db, actor, resource=GrantResource(GrantOn.mission, mission_id), request=request)


@router.patch("/projects/{project_id}/grants/{grant_id}", operation_id="update_project_grant")
async def update_project_grant(
    project_id: uuid.UUID, grant_id: uuid.UUID, changes: GrantUpdate, db: Transaction, actor: CurrentActor
) -> GrantRead:
    """Change the right or the end of a grant on a project; omitted fields stay."""
    resource = GrantResource(GrantOn.project, project_id)
    return await service.update_grant(db, actor, resource=resource, grant_id=grant_id, changes=changes)


@router.patch("/missions/{mission_id}/grants/{grant_id}", operation_id="update_mission_grant")
async def update_mission_grant(
    mission_id: uuid.UUID, grant_id: uuid.UUID, changes: GrantUpdate, db: Transaction, actor: CurrentActor
) -> GrantRead:
    """Change the right or the end of a grant on a mission; omitted fields stay."""
    resource = GrantResource(GrantOn.mission, mission_id)
    return await service.update_grant(db, actor, resource=resource, grant_id=grant_id, changes=changes)


@router.delete("/projects/{project_id}/grants/{grant_id}", operation_id="delete_project_grant", status_code=204)
async def delete_project_grant(
    project_id: uuid.UUID, grant_id: uuid.UUID, db: Transaction, actor: CurrentActor
) -> None:
    """Revoke a right on a project."""
    await service.delete_grant(db, actor, resource=GrantResource(GrantOn.project, project_id), grant_id=grant_id)


@router.delete("/missions/{mission_id}/grants/{grant_id}", operation_id="delete_mission_grant", status_code=204)
async def delete_mission_grant(
    mission_id: uuid.UUID, grant_id: uuid.UUID, db: Transaction, actor: CurrentActor
) -> None:
    """Revoke a right on a mission."""
    await service.delete_grant(db, actor, resource=GrantResource(GrantOn.mission, mission_id), grant_id=grant_id)


@router.get("/projects/{project_id}/access", operation_id="get_project_access")
async def get_project_access(
    project_id: uuid.UUID, query: ListQuery, db: Transaction, actor: CurrentActor
) -> Page[AccessRead]:
    """List who has a right on a project now, and why; without WRITE there, only your own access."""
    return await service.list_access(db, actor, resource=GrantResource(GrantOn.project, project_id), page=query.page)


@router.get("/missions/{mission_id}/access", operation_id="get_mission_access")
async def get_mission_access(
    mission_id: uuid.UUID, query: ListQuery, db: Transaction, actor: CurrentActor
) -> Page[AccessRead]:
    """List who has a right on a mission now, by grants on it or its project; without WRITE, only your own access."""
    return await service.list_access(db, actor, resource=GrantResource(GrantOn.mission, mission_id), page=query.page)
