"""Routes of the viewer's layouts."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.base import Page
from kleinkram.contract.viewer_layouts import ViewerLayoutCreate, ViewerLayoutRead, ViewerLayoutUpdate
from kleinkram.server.http.dependencies import CurrentActor, Reading, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import IfMatch
from kleinkram.server.pagination import PageQuery
from kleinkram.server.viewer_layouts import service

router = APIRouter(prefix="/api/v1", tags=["viewer layouts"], responses=FAILURE_RESPONSES)
_PATH = "/projects/{project_id}/viewer-layouts"


@router.get(_PATH, operation_id="list_viewer_layouts")
async def list_viewer_layouts(
    project_id: uuid.UUID, query: Annotated[PageQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[ViewerLayoutRead]:
    """List the shared layouts of a project, and the caller's own, by name."""
    return await service.list_layouts(db, actor, project_id=project_id, page=query.page)


@router.post(_PATH, operation_id="create_viewer_layout", status_code=201)
async def create_viewer_layout(
    project_id: uuid.UUID, new_layout: ViewerLayoutCreate, db: Transaction, actor: CurrentActor
) -> ViewerLayoutRead:
    """Add a layout to a project."""
    return await service.create_layout(db, actor, project_id=project_id, new_layout=new_layout)


@router.patch(_PATH + "/{layout_id}", operation_id="update_viewer_layout")
async def update_viewer_layout(
    project_id: uuid.UUID,
    layout_id: uuid.UUID,
    changes: ViewerLayoutUpdate,
    db: Transaction,
    actor: CurrentActor,
    if_match: IfMatch = None,
) -> ViewerLayoutRead:
    """Change a layout; omitted fields do not change."""
    place = service.LayoutPlace(project_id, layout_id)
    return await service.update_layout(db, actor, place=place, changes=changes, if_match=if_match)


@router.delete(_PATH + "/{layout_id}", operation_id="delete_viewer_layout", status_code=204)
async def delete_viewer_layout(
    project_id: uuid.UUID, layout_id: uuid.UUID, db: Transaction, actor: CurrentActor
) -> None:
    """Delete a layout."""
    await service.delete_layout(db, actor, place=service.LayoutPlace(project_id, layout_id))
