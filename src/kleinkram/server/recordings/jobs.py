"""The job that derives a mission's recordings from its files."""

import datetime
import time
import uuid

from procrastinate import JobContext

from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME
from kleinkram.server.jobs.attempts import RETRY_STRATEGY, app_context, back_pressure_of, worker_resource
from kleinkram.server.jobs.back_pressure import SUMMARY_MAX_WAIT_S
from kleinkram.server.jobs.queue import Job, enqueued_at, queue
from kleinkram.server.missions import service as missions
from kleinkram.server.overviews.topics import keep_topics
from kleinkram.server.recordings import deriving
from kleinkram.server.recordings.rests import Rests
from kleinkram.server.recordings.service import awaits_regrouping, regroup_later
from kleinkram.server.recordings.understanding import Understanding

_FEW_FILES = 50


@queue.task(name=Job.group_recordings.value, pass_context=True, retry=RETRY_STRATEGY)
async def group_recordings(job_context: JobContext, ref: str) -> None:
    """Derive a mission's recordings; whatever changes meanwhile asks for another round."""
    context, rests = app_context(job_context), worker_resource(job_context, "rests", Rests)
    mission_id = uuid.UUID(ref)
    if (left := rests.left(mission_id)) > datetime.timedelta():
        async with context.database.begin() as db:
            await regroup_later(db, mission_id, left)
        return
    async with context.database.begin() as db:
        since = await enqueued_at(db, job_context.job.id)
    await back_pressure_of(job_context).wait_for_uploads(SUMMARY_MAX_WAIT_S, since=since)
    began = time.monotonic()
    async with context.database.begin() as db:
        await missions.lock_mission(db, mission_id)
        rows = await deriving.live_files(db, mission_id, named=METADATA_NAME)
    stated = await worker_resource(job_context, "understanding", Understanding).of(context, rows)
    async with context.database.begin() as db:
        if not await missions.lock_mission(db, mission_id):
            return
        rows = await deriving.live_files(db, mission_id)
        await deriving.keep(db, mission_id, await deriving.derive(db, rows, stated), rows)
    rests.took(mission_id, time.monotonic() - began)
    async with context.database.begin() as db:
        # Of many files that takes a while: not for a state that is over already.
        if len(rows) <= _FEW_FILES or not await awaits_regrouping(db, mission_id):
            await keep_topics(db, mission_id)
