"""The trash over HTTP."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.contract.trash import TrashNoun, TrashRead
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction
from kleinkram.server.paging import PageRequest
from kleinkram.server.trash import service

router = APIRouter(prefix="/api/v1/trash", tags=["trash"])


class TrashListQuery(BaseModel):
    """The query of the trash."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    noun: TrashNoun | None = None
    limit: PageSize = 100
    cursor: Cursor | None = None


@router.get("", operation_id="list_trash")
async def list_trash(
    query: Annotated[TrashListQuery, Query()], db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> Page[TrashRead]:
    """List what was deleted and can still be had back, latest first."""
    page = PageRequest(query.limit, query.cursor)
    return await service.list_trash(db, actor, noun=query.noun, trash_days=settings.trash_days, page=page)


@router.post("/{noun}/{noun_id}/restore", operation_id="restore_from_trash", status_code=204)
async def restore_from_trash(
    noun: TrashNoun, noun_id: uuid.UUID, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> None:
    """Put a deleted thing back where it was."""
    await service.restore(db, actor, noun=noun, noun_id=noun_id, trash_days=settings.trash_days)
