"""Routes of mission events."""

import uuid
from typing import Annotated

from fastapi import APIRouter, Query

from kleinkram.contract.base import Page
from kleinkram.contract.mission_events import (
    MissionEventCreate,
    MissionEventFilter,
    MissionEventRead,
    MissionEventSort,
    MissionEventUpdate,
)
from kleinkram.server.http.dependencies import CurrentActor, Reading, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.http.headers import IfMatch
from kleinkram.server.mission_events import service
from kleinkram.server.pagination import CountedPageQuery

router = APIRouter(prefix="/api/v1", tags=["mission events"], responses=FAILURE_RESPONSES)


class MissionEventListQuery(MissionEventFilter, CountedPageQuery):
    """Query parameters of a list of events. A leading `-` of `sort` reverses the order."""

    sort: MissionEventSort = MissionEventSort.start


@router.post("/missions/{mission_id}/events", operation_id="create_mission_event", status_code=201)
async def create_mission_event(
    mission_id: uuid.UUID, new_event: MissionEventCreate, db: Transaction, actor: CurrentActor
) -> MissionEventRead:
    """Add an event to a mission; the event of this id or finding that it has is returned unchanged."""
    return await service.create_event(db, actor, mission_id=mission_id, new_event=new_event)


@router.get("/mission-events", operation_id="list_mission_events")
async def list_mission_events(
    query: Annotated[MissionEventListQuery, Query()], db: Reading, actor: CurrentActor
) -> Page[MissionEventRead]:
    """List the events of missions that match."""
    return await service.list_events(db, actor, matching=query, sort=query.sort, page=query.page)


@router.get("/mission-events/{event_id}", operation_id="get_mission_event")
async def get_mission_event(event_id: uuid.UUID, db: Reading, actor: CurrentActor) -> MissionEventRead:
    """Return one event."""
    return await service.get_event(db, actor, event_id)


@router.patch("/mission-events/{event_id}", operation_id="update_mission_event")
async def update_mission_event(
    event_id: uuid.UUID, changes: MissionEventUpdate, db: Transaction, actor: CurrentActor, if_match: IfMatch = None
) -> MissionEventRead:
    """Change an event; omitted fields do not change."""
    return await service.update_event(db, actor, event_id=event_id, changes=changes, if_match=if_match)


@router.delete("/mission-events/{event_id}", operation_id="delete_mission_event", status_code=204)
async def delete_mission_event(event_id: uuid.UUID, db: Transaction, actor: CurrentActor) -> None:
    """Delete an event."""
    await service.delete_event(db, actor, event_id=event_id)
