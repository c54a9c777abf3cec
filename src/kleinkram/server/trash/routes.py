"""Routes of the trash."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.base import Page
from kleinkram.contract.projects import TrashRead, TrashResourceType
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import PageQuery
from kleinkram.server.trash import service

router = APIRouter(prefix="/api/v1/trash", tags=["trash"], responses=FAILURE_RESPONSES)


class TrashListQuery(PageQuery):
    """Query parameters of the trash."""

    resource_type: TrashResourceType | None = None


@router.get("", operation_id="list_trash")
async def list_trash(
    query: Annotated[TrashListQuery, Query()], db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> Page[TrashRead]:
    """List what was deleted and can still be restored, latest first."""
    return await service.list_trash(
        db, actor, resource_type=query.resource_type, trash_days=settings.trash_days, page=query.page
    )


@router.post("/{resource_type}/{resource_id}/restore", operation_id="restore_from_trash", status_code=204)
async def restore_from_trash(
    resource_type: TrashResourceType,
    resource_id: uuid.UUID,
    db: Transaction,
    actor: CurrentActor,
    settings: CurrentSettings,
) -> None:
    """Restore a deleted project, mission or file."""
    await service.restore(
        db, actor, resource_type=resource_type, resource_id=resource_id, trash_days=settings.trash_days
    )
