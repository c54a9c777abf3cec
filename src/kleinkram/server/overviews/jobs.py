"""The job that derives the recordings and topics of a mission from its files.

A mission of ten thousand files changes with each that is read, and deriving it takes half a second:
`DerivationDebounce` delays it. `MetadataCache` reads each metadata.yaml of a mission in a child process, and caches it
by the object's key.
"""

import datetime
import math
import time
import uuid
from collections.abc import Sequence

from procrastinate import JobContext

from kleinkram.contract.names import file_name
from kleinkram.recordings import SummaryFailed
from kleinkram.recordings.formats.rosbag2.metadata import METADATA_NAME, Rosbag2Metadata
from kleinkram.recordings.isolation import MetadataRequest, request_bytes
from kleinkram.server.blobs.readers import ReaderProcesses
from kleinkram.server.context import AppContext
from kleinkram.server.jobs.execution import (
    RETRY_STRATEGY,
    SUMMARY_MAX_WAIT_S,
    app_context,
    back_pressure_of,
    worker_resource,
)
from kleinkram.server.jobs.queue import Job, enqueued_at, queue
from kleinkram.server.jobs.rejudge import judge_again
from kleinkram.server.missions import service as missions
from kleinkram.server.overviews.topics import store_topics
from kleinkram.server.recordings import derive
from kleinkram.server.recordings.derive import LiveFile, MetadataFiles, awaits_derivation, derive_again_later
from kleinkram.server.runs.automatic import enqueue_automatic_runs

# A mission that takes less is derived at once, because people look at what they upload.
_LONG_S = 0.1
# The delay: so many times as long as deriving took, for each delayed mission; and its limit.
_DELAY_FACTOR, _MAX_DELAY_S = 4.0, 30.0


class DerivationDebounce:
    """Delays of the missions that took long to derive. One per worker."""

    def __init__(self) -> None:
        self._until: dict[uuid.UUID, float] = {}

    def took(self, mission_id: uuid.UUID, seconds: float) -> None:
        """Note how long it took to derive a mission."""
        now = time.monotonic()
        self._until = {delayed_id: until for delayed_id, until in self._until.items() if until > now}
        if seconds >= _LONG_S:
            count = len({*self._until, mission_id})
            self._until[mission_id] = now + min(seconds * _DELAY_FACTOR * count, _MAX_DELAY_S)

    def left(self, mission_id: uuid.UUID) -> datetime.timedelta:
        """Return the remaining delay of a mission; zero or negative where there is none."""
        now = time.monotonic()
        return datetime.timedelta(seconds=self._until.get(mission_id, now) - now)


# About 1400 topics. Untrusted YAML takes 18 s per megabyte; larger files are not read.
_LIMIT_BYTES = 256 * 1024
_LIMIT_S = 60.0
# Of text; parsed, it takes about five times as much memory.
_CACHED_BYTES = 8 * 1024 * 1024


class MetadataCache:
    """Parses metadata.yaml files, and caches them up to a limit. One per worker."""

    def __init__(self, readers: ReaderProcesses) -> None:
        self._readers = readers
        self._known: dict[str, Rosbag2Metadata | SummaryFailed | None] = {}
        self._size_bytes = 0

    async def of(self, context: AppContext, files: Sequence[LiveFile]) -> MetadataFiles:
        """Return the content of the metadata.yaml files among these, by path; None for an invalid one.

        Those that are too large, too expensive to read, or missing from the store are left out.
        """
        metadata_files: dict[str, Rosbag2Metadata | None] = {}
        for one in files:
            if file_name(one.path) != METADATA_NAME or one.size_bytes > _LIMIT_BYTES:
                continue
            if one.key not in self._known:
                try:
                    await self._parse(context, one)
                except FileNotFoundError:
                    continue
            metadata = self._known[one.key]
            if not isinstance(metadata, SummaryFailed):
                metadata_files[one.path] = metadata
        return metadata_files

    async def _parse(self, context: AppContext, one: LiveFile) -> None:
        body = b"".join([piece async for piece in context.storage.read(one.key)])
        timeout_s = min(_LIMIT_S, context.settings.summary_timeout_s)
        request = request_bytes(
            MetadataRequest(body.decode("utf-8", "replace")),
            memory_bytes=context.settings.summary_memory_bytes,
            timeout_s=math.ceil(timeout_s),
        )
        metadata: Rosbag2Metadata | SummaryFailed | None
        try:
            metadata = await self._readers.metadata(request, owner=one.uploaded_by_id, timeout_s=timeout_s)
        except SummaryFailed as failure:  # cached, because it would fail again
            metadata = failure
        if self._size_bytes + len(body) > _CACHED_BYTES:
            self._known, self._size_bytes = {}, 0
        self._known[one.key] = metadata
        self._size_bytes += len(body)


# The topics of a mission with more files are not stored for a state that has changed already.
_MAX_FILES_TO_STORE_OUTDATED = 50


@queue.task(name=Job.derive_recordings.value, pass_context=True, retry=RETRY_STRATEGY)
async def derive_recordings(job_context: JobContext, ref: str) -> None:
    """Derive a mission's recordings; a change in the meantime enqueues another job."""
    context, mission_id = app_context(job_context), uuid.UUID(ref)
    debounce = worker_resource(job_context, "derivation_debounce", DerivationDebounce)
    if (left := debounce.left(mission_id)) > datetime.timedelta():
        async with context.database.begin() as db:
            await derive_again_later(db, mission_id, left)
        return
    async with context.database.begin() as db:
        since = await enqueued_at(db, job_context.job.id)
    await back_pressure_of(job_context).wait_for_uploads(SUMMARY_MAX_WAIT_S, since=since)
    began = time.monotonic()
    async with context.database.begin() as db:
        await missions.lock_mission(db, mission_id)
        files = await derive.live_files(db, mission_id, named=METADATA_NAME)
    metadata_files = await worker_resource(job_context, "metadata_cache", MetadataCache).of(context, files)
    async with context.database.begin() as db:
        if not await missions.lock_mission(db, mission_id):
            return
        files = await derive.live_files(db, mission_id)
        await derive.store(db, mission_id, await derive.derive(db, files, metadata_files), files)
    debounce.took(mission_id, time.monotonic() - began)
    async with context.database.begin() as db:
        if len(files) <= _MAX_FILES_TO_STORE_OUTDATED or not await awaits_derivation(db, mission_id):
            await store_topics(db, mission_id)
            await judge_again(db, [mission_id])
            await enqueue_automatic_runs(db, mission_id=mission_id)
