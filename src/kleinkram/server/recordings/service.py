"""Recordings: reading them, and requesting that they are derived again, which every change of files does."""

import datetime
import uuid

from sqlalchemy import Text, cast, select, text, update

from kleinkram.contract.base import Page
from kleinkram.contract.errors import NotFound
from kleinkram.contract.files import RecordingRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection
from kleinkram.server.jobs.queue import Job, Priority, enqueue, has_job
from kleinkram.server.missions import service as missions
from kleinkram.server.pagination import PageRequest, read_page
from kleinkram.server.recordings import queries
from kleinkram.server.tables import mission, mission_topics

_WAITING = text(
    "SELECT 1 FROM procrastinate_jobs WHERE task_name = :task AND status = 'todo' AND args ->> 'ref' = :ref LIMIT 1"
)


async def regroup(db: Connection, mission_id: uuid.UUID) -> None:
    """Have a mission's recordings derived again after this transaction.

    A queued job suffices. It cannot miss this change, because it begins by acquiring the lock on the mission that this
    transaction holds.
    """
    changed = update(mission).where(mission.c.id == mission_id).values(files_revision=mission.c.files_revision + 1)
    await db.execute(changed)
    if not await awaits_regrouping(db, mission_id):
        await enqueue(db, Job.group_recordings, ids=[str(mission_id)], priority=Priority.high)


async def regroup_later(db: Connection, mission_id: uuid.UUID, later: datetime.timedelta) -> None:
    """Have a mission's recordings derived after a delay, together with later changes."""
    if not await awaits_regrouping(db, mission_id):
        await enqueue(db, Job.group_recordings, ids=[str(mission_id)], priority=Priority.high, later=later)


async def awaits_regrouping(db: Connection, mission_id: uuid.UUID) -> bool:
    """Return whether a job that derives a mission's recordings is queued."""
    waiting = await db.execute(_WAITING, {"task": Job.group_recordings.value, "ref": str(mission_id)})
    return waiting.first() is not None


async def regroup_forgotten(db: Connection, *, limit: int) -> None:
    """Enqueue jobs for missions whose recordings or topics are outdated, and that have no queued or running job."""
    current = select(mission_topics.c.mission_id).where(mission_topics.c.revision == mission.c.files_revision)
    stale = select(cast(mission.c.id, Text)).where(
        (mission.c.derived_revision != mission.c.files_revision)
        | ((mission.c.files_revision > 0) & ~current.where(mission_topics.c.mission_id == mission.c.id).exists()),
        ~has_job(Job.group_recordings, mission.c.id),
    )
    ids = (await db.execute(stale.limit(limit))).scalars().all()
    await enqueue(db, Job.group_recordings, ids=ids, priority=Priority.normal)


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
    statement = queries.recordings_of(actor, mission_id)
    return await read_page(db, statement, queries.RECORDING_ORDER, page, queries.to_recording)
