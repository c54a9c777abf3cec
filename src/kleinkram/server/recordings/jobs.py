"""The job that derives a mission's recordings from its files."""

import asyncio
import uuid
from collections.abc import Sequence
from typing import Any

from procrastinate import JobContext
from sqlalchemy import Row

from kleinkram.recordings import Rosbag2Metadata, group, parse_rosbag2_metadata
from kleinkram.server.jobs.context import PATIENTLY, courtesy_of, site_of
from kleinkram.server.jobs.courtesy import SUMMARY_PATIENCE_S
from kleinkram.server.jobs.queue import Job, queue
from kleinkram.server.missions import service as missions
from kleinkram.server.recordings import deriving
from kleinkram.server.site import Site

# About 1400 topics. Untrusted YAML takes 18 s a megabyte; what is larger is taken for no metadata at all.
_METADATA_LIMIT_BYTES = 256 * 1024


@queue.task(name=Job.group_recordings.value, pass_context=True, retry=PATIENTLY)
async def group_recordings(context: JobContext, ref: str) -> None:
    """Derive a mission's recordings; whatever changes meanwhile asks for another round."""
    site = site_of(context)
    mission_id = uuid.UUID(ref)
    await courtesy_of(context).give_way(SUMMARY_PATIENCE_S)
    async with site.database.begin() as db:
        await missions.lock_mission(db, mission_id)
        rows = await deriving.live_files(db, mission_id)
    stated = await _read_metadata(site, rows)
    async with site.database.begin() as db:
        if not await missions.lock_mission(db, mission_id):
            return
        rows = await deriving.live_files(db, mission_id)
        await deriving.keep(db, mission_id, deriving.derive(rows, stated), rows)


async def _read_metadata(site: Site, rows: Sequence[Row[Any]]) -> dict[str, Rosbag2Metadata]:
    by_path = {row.path: row for row in rows}
    stated: dict[str, Rosbag2Metadata] = {}
    for each in group(by_path):
        row = by_path.get(each.metadata_path or "")
        if row is None or row.size_bytes > _METADATA_LIMIT_BYTES:
            continue
        try:
            body = b"".join([piece async for piece in site.storage.read(row.key)])
        except FileNotFoundError:
            continue
        # In a thread: the worker's heartbeat goes on meanwhile.
        parsed = await asyncio.to_thread(parse_rosbag2_metadata, body.decode("utf-8", "replace"))
        if parsed is not None:
            stated[row.path] = parsed
    return stated
