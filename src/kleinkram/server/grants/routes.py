"""Grants over HTTP: the same on projects and on missions."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.grants import AccessRead, GrantCreate, GrantOn, GrantRead, GrantUpdate
from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.server.grants import service
from kleinkram.server.grants.queries import Place
from kleinkram.server.http.dependencies import CurrentActor, Transaction
from kleinkram.server.paging import PageRequest

router = APIRouter(prefix="/api/v1", tags=["access"])


class GrantListQuery(BaseModel):
    """Which page of a list."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    limit: PageSize = 100
    cursor: Cursor | None = None

    @property
    def page(self) -> PageRequest:
        """The same, as lists take it."""
        return PageRequest(self.limit, self.cursor)


ListQuery = Annotated[GrantListQuery, Query()]


@router.get("/projects/{project_id}/grants", operation_id="list_project_grants")
async def list_project_grants(
    project_id: uuid.UUID, query: ListQuery, db: Transaction, actor: CurrentActor
) -> Page[GrantRead]:
    """List the grants on a project, by the name of whom they are to; those that have expired too."""
    return await service.list_grants(db, actor, place=Place(GrantOn.project, project_id), page=query.page)


@router.get("/missions/{mission_id}/grants", operation_id="list_mission_grants")
async def list_mission_grants(
    mission_id: uuid.UUID, query: ListQuery, db: Transaction, actor: CurrentActor
) -> Page[GrantRead]:
    """List the grants on a mission by itself."""
    return await service.list_grants(db, actor, place=Place(GrantOn.mission, mission_id), page=query.page)


@router.post("/projects/{project_id}/grants", operation_id="create_project_grant", status_code=201)
async def create_project_grant(
    project_id: uuid.UUID, wanted: GrantCreate, db: Transaction, actor: CurrentActor
) -> GrantRead:
    """Give a right on a project and all its missions; it takes the place of the one given there before."""
    return await service.give(db, actor, place=Place(GrantOn.project, project_id), wanted=wanted)


@router.post("/missions/{mission_id}/grants", operation_id="create_mission_grant", status_code=201)
async def create_mission_grant(
    mission_id: uuid.UUID, wanted: GrantCreate, db: Transaction, actor: CurrentActor
) -> GrantRead:
    """Give a right on one mission; it shows the project's name, and nothing else of it."""
    return await service.give(db, actor, place=Place(GrantOn.mission, mission_id), wanted=wanted)


@router.patch("/projects/{project_id}/grants/{grant_id}", operation_id="update_project_grant")
async def update_project_grant(
    project_id: uuid.UUID, grant_id: uuid.UUID, changes: GrantUpdate, db: Transaction, actor: CurrentActor
) -> GrantRead:
    """Change what right a grant on a project gives, or until when; what is left out stays."""
    place = Place(GrantOn.project, project_id)
    return await service.change(db, actor, place=place, grant_id=grant_id, changes=changes)


@router.patch("/missions/{mission_id}/grants/{grant_id}", operation_id="update_mission_grant")
async def update_mission_grant(
    mission_id: uuid.UUID, grant_id: uuid.UUID, changes: GrantUpdate, db: Transaction, actor: CurrentActor
) -> GrantRead:
    """Change what right a grant on a mission gives, or until when; what is left out stays."""
    place = Place(GrantOn.mission, mission_id)
    return await service.change(db, actor, place=place, grant_id=grant_id, changes=changes)


@router.delete("/projects/{project_id}/grants/{grant_id}", operation_id="delete_project_grant", status_code=204)
async def delete_project_grant(
    project_id: uuid.UUID, grant_id: uuid.UUID, db: Transaction, actor: CurrentActor
) -> None:
    """Take a right on a project away."""
    await service.revoke(db, actor, place=Place(GrantOn.project, project_id), grant_id=grant_id)


@router.delete("/missions/{mission_id}/grants/{grant_id}", operation_id="delete_mission_grant", status_code=204)
async def delete_mission_grant(
    mission_id: uuid.UUID, grant_id: uuid.UUID, db: Transaction, actor: CurrentActor
) -> None:
    """Take a right on a mission away."""
    await service.revoke(db, actor, place=Place(GrantOn.mission, mission_id), grant_id=grant_id)


@router.get("/projects/{project_id}/access", operation_id="get_project_access")
async def get_project_access(
    project_id: uuid.UUID, query: ListQuery, db: Transaction, actor: CurrentActor
) -> Page[AccessRead]:
    """List who has a right on a project now, and by what; without WRITE there, only the asker's own ways."""
    return await service.list_access(db, actor, place=Place(GrantOn.project, project_id), page=query.page)


@router.get("/missions/{mission_id}/access", operation_id="get_mission_access")
async def get_mission_access(
    mission_id: uuid.UUID, query: ListQuery, db: Transaction, actor: CurrentActor
) -> Page[AccessRead]:
    """List who has a right on a mission now, by grants on it or on its project; without WRITE, only the asker's own."""
    return await service.list_access(db, actor, place=Place(GrantOn.mission, mission_id), page=query.page)
