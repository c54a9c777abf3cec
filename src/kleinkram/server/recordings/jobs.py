"""Jobs that derive the recordings of missions from their files.

A mission of ten thousand files changes with each that is read, and deriving it takes half a second: `Rests` debounces.
`Understanding` reads each metadata.yaml of a mission in a child process, and caches it by the object's key.
"""

import datetime
import math
import time
import uuid
from collections.abc import Sequence
from typing import Any

from procrastinate import JobContext
from sqlalchemy import Row

from kleinkram.contract.names import file_name
from kleinkram.recordings import SummaryFailed
from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME, Rosbag2Metadata
from kleinkram.recordings.isolation import MetadataRequest, request_bytes
from kleinkram.server.blobs.reader_processes import ReaderProcesses
from kleinkram.server.context import AppContext
from kleinkram.server.jobs.execution import (
    RETRY_STRATEGY,
    SUMMARY_MAX_WAIT_S,
    app_context,
    back_pressure_of,
    worker_resource,
)
from kleinkram.server.jobs.queue import Job, enqueued_at, queue
from kleinkram.server.missions import service as missions
from kleinkram.server.overviews.topics import keep_topics
from kleinkram.server.recordings import derive
from kleinkram.server.recordings.service import awaits_regrouping, regroup_later

# What takes less is derived at once: people look at what they bring.
_LONG_S = 0.1
# So many times as long as it took, for each that rests; a change is seen after so long at the latest.
_TIMES, _MOST_S = 4.0, 30.0


class RegroupDebounce:
    """Until when each mission rests that took long. One a worker."""

    def __init__(self) -> None:
        self._until: dict[uuid.UUID, float] = {}

    def took(self, mission_id: uuid.UUID, seconds: float) -> None:
        """Note how long it took to derive a mission."""
        now = time.monotonic()
        self._until = {resting_id: until for resting_id, until in self._until.items() if until > now}
        if seconds >= _LONG_S:
            at_rest = len({*self._until, mission_id})
            self._until[mission_id] = now + min(seconds * _TIMES * at_rest, _MOST_S)

    def left(self, mission_id: uuid.UUID) -> datetime.timedelta:
        """Return how long a mission rests from now; nothing or less when it does not."""
        now = time.monotonic()
        return datetime.timedelta(seconds=self._until.get(mission_id, now) - now)


# About 1400 topics. Untrusted YAML takes 18 s a megabyte; what is larger is not looked at.
_LIMIT_BYTES = 256 * 1024
_LIMIT_S = 60.0
# Of text; understood it takes some five times as much.
_REMEMBERED_BYTES = 8 * 1024 * 1024


class MetadataCache:
    """Understands metadata.yaml files, and remembers them up to a bound. One a worker."""

    def __init__(self, readers: ReaderProcesses) -> None:
        self._readers = readers
        self._known: dict[str, Rosbag2Metadata | SummaryFailed | None] = {}
        self._size_bytes = 0

    async def of(self, context: AppContext, rows: Sequence[Row[Any]]) -> dict[str, Rosbag2Metadata | None]:
        """Return by path what the metadata.yaml files among these say; None for one that is no such thing.

        Those that are too large, cost too much to read, or are gone from the store, are left out.
        """
        stated: dict[str, Rosbag2Metadata | None] = {}
        for row in rows:
            if file_name(row.path) != METADATA_NAME or row.size_bytes > _LIMIT_BYTES:
                continue
            if row.key not in self._known:
                try:
                    await self._learn(context, row)
                except FileNotFoundError:
                    continue
            metadata = self._known[row.key]
            if not isinstance(metadata, SummaryFailed):
                stated[row.path] = metadata
        return stated

    async def _learn(self, context: AppContext, row: Row[Any]) -> None:
        body = b"".join([piece async for piece in context.storage.read(row.key)])
        timeout_s = min(_LIMIT_S, context.settings.summary_timeout_s)
        request = request_bytes(
            MetadataRequest(body.decode("utf-8", "replace")),
            memory_bytes=context.settings.summary_memory_bytes,
            timeout_s=math.ceil(timeout_s),
        )
        metadata: Rosbag2Metadata | SummaryFailed | None
        try:
            metadata = await self._readers.metadata(request, owner=row.uploaded_by_id, timeout_s=timeout_s)
        except SummaryFailed as failure:  # it would cost as much the next time
            metadata = failure
        if self._size_bytes + len(body) > _REMEMBERED_BYTES:
            self._known, self._size_bytes = {}, 0
        self._known[row.key] = metadata
        self._size_bytes += len(body)


_MAX_UNHURRIED_FILES = 50


@queue.task(name=Job.group_recordings.value, pass_context=True, retry=RETRY_STRATEGY)
async def group_recordings(job_context: JobContext, ref: str) -> None:
    """Derive a mission's recordings; whatever changes meanwhile asks for another round."""
    context, rests = app_context(job_context), worker_resource(job_context, "rests", RegroupDebounce)
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
        rows = await derive.live_files(db, mission_id, named=METADATA_NAME)
    stated = await worker_resource(job_context, "understanding", MetadataCache).of(context, rows)
    async with context.database.begin() as db:
        if not await missions.lock_mission(db, mission_id):
            return
        rows = await derive.live_files(db, mission_id)
        await derive.keep(db, mission_id, await derive.derive(db, rows, stated), rows)
    rests.took(mission_id, time.monotonic() - began)
    async with context.database.begin() as db:
        # Of many files that takes a while: not for a state that is over already.
        if len(rows) <= _MAX_UNHURRIED_FILES or not await awaits_regrouping(db, mission_id):
            await keep_topics(db, mission_id)
