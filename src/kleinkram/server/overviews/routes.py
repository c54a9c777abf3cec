"""Overviews over HTTP."""

import uuid

from fastapi import APIRouter

from kleinkram.contract.paging import Cursor
from kleinkram.contract.timelines import MAX_TIMELINE_FILES, MissionTimeline, TimelineSize
from kleinkram.contract.topics import Bins, MissionTopics, MissionTopicsSize
from kleinkram.server.dependencies import CurrentActor, Transaction
from kleinkram.server.overviews import service, topics
from kleinkram.server.pages import PageRequest

router = APIRouter(prefix="/api/v1", tags=["overviews"])


@router.get("/missions/{mission_id}/timeline", operation_id="get_mission_timeline")
async def get_mission_timeline(
    mission_id: uuid.UUID,
    db: Transaction,
    actor: CurrentActor,
    limit: TimelineSize = MAX_TIMELINE_FILES,
    cursor: Cursor | None = None,
) -> MissionTimeline:
    """Return when each file of a mission was recorded, by path: enough to draw all of them on one axis of time."""
    return await service.get_timeline(db, actor, mission_id=mission_id, page=PageRequest(limit, cursor))


@router.get("/missions/{mission_id}/topics", operation_id="list_mission_topics")
async def list_mission_topics(
    mission_id: uuid.UUID,
    db: Transaction,
    actor: CurrentActor,
    bins: Bins = 256,
    limit: MissionTopicsSize = 1_000,
    cursor: Cursor | None = None,
) -> MissionTopics:
    """List the topics of all recordings of a mission, by name and type, with their messages in at most `bins` bins."""
    page = PageRequest(limit, cursor)
    return await topics.list_mission_topics(db, actor, mission_id=mission_id, bins=bins, page=page)
