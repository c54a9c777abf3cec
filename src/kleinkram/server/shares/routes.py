"""Links over HTTP: for those who make them, and for those who have one."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from kleinkram.contract.paging import Cursor, Page, PageSize
from kleinkram.contract.shares import ShareCreate, SharedRead, ShareMade, ShareRead
from kleinkram.server.http.dependencies import CurrentActor, CurrentSettings, Transaction
from kleinkram.server.paging import PageRequest
from kleinkram.server.shares import service

router = APIRouter(prefix="/api/v1", tags=["shares"])


class ShareListQuery(BaseModel):
    """The query of a list of links."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    mission_id: uuid.UUID | None = None
    ended: bool = False
    limit: PageSize = 100
    cursor: Cursor | None = None


@router.post("/missions/{mission_id}/shares", operation_id="create_share", status_code=201)
async def create_share(
    mission_id: uuid.UUID, wanted: ShareCreate, db: Transaction, actor: CurrentActor, settings: CurrentSettings
) -> ShareMade:
    """Make a link to a mission or to some of its files; its secret is shown here and never again."""
    return await service.create_share(db, actor, settings=settings, mission_id=mission_id, wanted=wanted)


@router.get("/shares", operation_id="list_shares")
async def list_shares(
    query: Annotated[ShareListQuery, Query()], db: Transaction, actor: CurrentActor
) -> Page[ShareRead]:
    """List the links that you may revoke, latest first; with `ended` also those that are over."""
    page = PageRequest(query.limit, query.cursor)
    return await service.list_shares(db, actor, mission_id=query.mission_id, with_ended=query.ended, page=page)


@router.delete("/shares/{share_id}", operation_id="revoke_share", status_code=204)
async def revoke_share(share_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """End a link, from the next request on."""
    await service.revoke_share(db, actor, share_id=share_id)


@router.get("/share", operation_id="get_share")
async def get_shared(db: Transaction, actor: CurrentActor) -> SharedRead:
    """Say what the link shows that the request came with."""
    return await service.get_shared(db, actor)
