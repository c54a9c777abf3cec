"""Deriving recordings from the files of a mission. Never by hand: whatever changes files asks for it anew."""

import uuid

from sqlalchemy import text, update

from kleinkram.server.db import Connection
from kleinkram.server.jobs.queue import Job, Urgency, enqueue
from kleinkram.server.tables import mission

_WAITING = text(
    "SELECT 1 FROM procrastinate_jobs WHERE task_name = :task AND status = 'todo' AND args ->> 'ref' = :ref LIMIT 1"
)


async def regroup(db: Connection, mission_id: uuid.UUID) -> None:
    """See to it that a mission's recordings are derived again, once this transaction is through.

    A job that waits already will do. It cannot miss this change: it begins by taking the lock on the mission that is
    taken here, so it looks after this transaction has ended.
    """
    changed = update(mission).where(mission.c.id == mission_id).values(files_revision=mission.c.files_revision + 1)
    await db.execute(changed)
    waiting = await db.execute(_WAITING, {"task": Job.group_recordings.value, "ref": str(mission_id)})
    if waiting.first() is None:
        await enqueue(db, Job.group_recordings, ids=[str(mission_id)], urgency=Urgency.soon)
