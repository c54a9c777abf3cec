"""Reading recordings: who may see which."""

import uuid

from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import RecordingRead
from kleinkram.contract.paging import Page
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection
from kleinkram.server.missions import service as missions
from kleinkram.server.pages import PageRequest, fetch_page
from kleinkram.server.recordings import queries


async def get_recording(db: Connection, actor: Actor, recording_id: uuid.UUID) -> RecordingRead:
    """Return one recording.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = (await db.execute(queries.recording_by_id(actor, recording_id))).one_or_none()
    if row is None:
        raise NotFound(noun="recording", ref=str(recording_id))
    return queries.to_recording(row)


async def list_recordings(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, page: PageRequest
) -> Page[RecordingRead]:
    """Return a page of a mission's recordings, by name.

    Raises:
        NotFound: the mission is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    await missions.get_mission_row(db, actor, mission_id)
    rows = await fetch_page(db, queries.recordings_of(actor, mission_id), queries.RECORDING_ORDER, page)
    return Page(items=[queries.to_recording(row) for row in rows.items], next=rows.next, total=rows.total)
