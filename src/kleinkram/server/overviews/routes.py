"""Routes of timelines, mission topics and statistics."""

import uuid

from fastapi import APIRouter

from kleinkram.contract.base import Cursor
from kleinkram.contract.files import (
    MAX_TIMELINE_FILES,
    Bins,
    MissionTimeline,
    MissionTopics,
    MissionTopicsSize,
    TimelineSize,
)
from kleinkram.contract.names import Term
from kleinkram.contract.search import Buckets, Overview
from kleinkram.server.http.dependencies import CurrentActor, Transaction
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.overviews import service, topics
from kleinkram.server.pagination import PageRequest

router = APIRouter(prefix="/api/v1", tags=["overviews"], responses=FAILURE_RESPONSES)


@router.get("/missions/{mission_id}/timeline", operation_id="get_mission_timeline")
async def get_mission_timeline(
    mission_id: uuid.UUID,
    db: Transaction,
    actor: CurrentActor,
    limit: TimelineSize = MAX_TIMELINE_FILES,
    cursor: Cursor | None = None,
) -> MissionTimeline:
    """Return start and end of each file of a mission, by path."""
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
    """List the topics of a mission by name and type, with message counts in at most `bins` bins."""
    page = PageRequest(limit, cursor)
    return await topics.list_mission_topics(db, actor, mission_id=mission_id, bins=bins, page=page)


@router.get("/projects/{project_id}/stats", operation_id="get_project_stats")
async def get_project_stats(
    project_id: uuid.UUID, db: Transaction, actor: CurrentActor, by: Term = "month", max_buckets: Buckets = 20
) -> Overview:
    """Return hours, bytes and files of a project, by `month` or by the values of a metadata field."""
    return await service.get_project_stats(db, actor, project_id=project_id, by=by, max_buckets=max_buckets)


@router.get("/overview", operation_id="get_overview")
async def get_overview(
    db: Transaction,
    actor: CurrentActor,
    by: Term = "month",
    max_buckets: Buckets = 20,
    project_id: uuid.UUID | None = None,
) -> Overview:
    """Return statistics of all visible missions, or of those of one project, by `month` or by a metadata field."""
    return await service.get_overview(db, actor, project_id=project_id, by=by, max_buckets=max_buckets)
