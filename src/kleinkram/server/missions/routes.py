"""Routes of missions."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.base import Cursor, Page, PageSize
from kleinkram.contract.files import FileFilter
from kleinkram.contract.mission_positions import MissionPositions
from kleinkram.contract.missions import (
    MissionCreate,
    MissionFilter,
    MissionOrder,
    MissionRead,
    MissionSort,
    MissionUpdate,
)
from kleinkram.contract.projects import Deleted
from kleinkram.contract.query import parse
from kleinkram.contract.search import QueryText
from kleinkram.server.http.dependencies import CurrentActor, Reading, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import IfMatch
from kleinkram.server.missions import positions, service
from kleinkram.server.pagination import PageRequest

router = APIRouter(prefix="/api/v1", tags=["missions"], responses=FAILURE_RESPONSES)


class MissionQuery(MissionFilter):
    """Query parameters that select missions; `query` finds missions by their own fields or by their files."""

    query: QueryText | None = None

    @property
    def matching(self) -> MissionFilter:
        """The filter of missions alone."""
        return MissionFilter.model_construct(**{name: getattr(self, name) for name in MissionFilter.model_fields})

    @property
    def by_files(self) -> FileFilter | None:
        """The filter that the query is. Raises InvalidQuery."""
        return None if self.query is None else parse(self.query)


class MissionListQuery(MissionQuery):
    """Query parameters of a list of missions.

    `sort` is a column, or a field of the metadata such as `meta.robot`; a leading `-` reverses it.
    """

    sort: MissionOrder = MissionSort.name
    limit: PageSize = 100
    cursor: Cursor | None = None
    count: bool = False


@router.post("/projects/{project_id}/missions", operation_id="create_mission", status_code=201)
async def create_mission(
    project_id: uuid.UUID, new_mission: MissionCreate, db: Transaction, actor: CurrentActor
) -> MissionRead:
    """Create a mission; its metadata must satisfy the project's fields."""
    return await service.create_mission(db, actor, project_id=project_id, new_mission=new_mission)


@router.get("/missions", operation_id="list_missions")
async def list_missions(
    query: Annotated[MissionListQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[MissionRead]:
    """List the missions that match."""
    page = PageRequest(query.limit, query.cursor, query.count)
    return await service.list_missions(
        db, actor, matching=query.matching, by_files=query.by_files, sort=query.sort, page=page
    )


@router.get("/mission-positions", operation_id="list_mission_positions")
async def list_mission_positions(
    query: Annotated[MissionQuery, Query()], db: Reading, actor: CurrentActor
) -> MissionPositions:
    """Return where the latest missions that match were recorded: their first positions."""
    return await positions.list_mission_positions(db, actor, matching=query.matching, by_files=query.by_files)


@router.get("/missions/{mission_id}", operation_id="get_mission")
async def get_mission(mission_id: uuid.UUID, db: Reading, actor: CurrentActor) -> MissionRead:
    """Return one mission."""
    return await service.get_mission(db, actor, mission_id)


@router.patch("/missions/{mission_id}", operation_id="update_mission")
async def update_mission(
    mission_id: uuid.UUID, changes: MissionUpdate, db: Transaction, actor: CurrentActor, if_match: IfMatch = None
) -> MissionRead:
    """Rename, move, complete or describe a mission; omitted fields do not change."""
    return await service.update_mission(db, actor, mission_id=mission_id, changes=changes, if_match=if_match)


@router.delete("/missions/{mission_id}", operation_id="delete_mission")
async def delete_mission(mission_id: uuid.UUID, db: Transaction, actor: CurrentActor, dry_run: bool = False) -> Deleted:
    """Move a mission and its files to the trash."""
    return await service.delete_mission(db, actor, mission_id=mission_id, dry_run=dry_run)
