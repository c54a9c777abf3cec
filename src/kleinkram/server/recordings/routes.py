"""Routes of recordings."""

import uuid

from fastapi import APIRouter

from kleinkram.contract.base import Cursor, Page, PageSize
from kleinkram.contract.files import RecordingRead
from kleinkram.server.http.dependencies import CurrentActor, Reading
from kleinkram.server.http.errors import FAILURE_RESPONSES
from kleinkram.server.pagination import PageRequest
from kleinkram.server.recordings import service

router = APIRouter(prefix="/api/v1", tags=["recordings"], responses=FAILURE_RESPONSES)


@router.get("/missions/{mission_id}/recordings", operation_id="list_recordings")
async def list_recordings(
    mission_id: uuid.UUID,
    db: Reading,
    actor: CurrentActor,
    limit: PageSize = 100,
    cursor: Cursor | None = None,
) -> Page[RecordingRead]:
    """List the recordings of a mission, by name."""
    return await service.list_recordings(db, actor, mission_id=mission_id, page=PageRequest(limit, cursor))


@router.get("/recordings/{recording_id}", operation_id="get_recording")
async def get_recording(recording_id: uuid.UUID, db: Reading, actor: CurrentActor) -> RecordingRead:
    """Return one recording."""
    return await service.get_recording(db, actor, recording_id)
