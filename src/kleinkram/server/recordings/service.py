"""The recordings of a mission, as people read them; `derive.py` makes them."""

import uuid

from kleinkram.contract.base import Page
from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import RecordingRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection
from kleinkram.server.missions import service as missions
from kleinkram.server.pagination import PageRequest, read_page
from kleinkram.server.recordings import queries


async def get_recording(db: Connection, actor: Actor, recording_id: uuid.UUID) -> RecordingRead:
    """Return one recording.

    Raises:
        NotFound: it does not exist, or is not visible.
    """
    row = (await db.execute(queries.recording_by_id(actor, recording_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="recording", ref=str(recording_id))
    return queries.to_recording(row)


async def list_recordings(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, page: PageRequest
) -> Page[RecordingRead]:
    """Return a page of a mission's recordings, by name.

    Raises:
        NotFound: the mission does not exist, or is not visible.
        InvalidCursor: the cursor is not of this list.
    """
    await missions.get_mission_ref(db, actor, mission_id)
    statement = queries.recordings_of(actor, [mission_id])
    return await read_page(db, statement, queries.RECORDING_ORDER, page, queries.to_recording)
