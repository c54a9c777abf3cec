"""Home, put together: a handful of statements in one transaction, then the store for what it holds of uploads."""

import asyncio
import shutil
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.home import (
    Attention,
    HomeRead,
    HomeStorage,
    Need,
    ProjectStorage,
    RecentMission,
    StoreUse,
    UnfinishedUpload,
)
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.home import queries
from kleinkram.server.runners.scheduling import has_single_person, known_runners, reason_never_starts
from kleinkram.server.settings import Settings

_MISSIONS, _UPLOADS, _AILING, _PROJECTS = 10, 20, 20, 20
# Kinds of queued runs that are looked at; one kind is one action on one mission.
_QUEUED = 200
_STORE_PATIENCE_S = 2.0
# As `klein doctor` says.
_LOW_BYTES, _LOW_SHARE = 5 * 1024**3, 0.02
# What is wrong with the bytes goes before what is wrong with what they say.
_OF_STATE = {"corrupt": Need.files_corrupt, "lost": Need.files_lost}
_OF_CONTENT = {"broken": Need.files_broken, "error": Need.files_unread, "recovered": Need.files_recovered}


async def get_home(context: AppContext, actor: Actor) -> HomeRead:
    """Return what somebody finds when they come. A store that does not answer only leaves out what it holds."""
    async with context.database.begin() as db:
        missions = (await db.execute(queries.recent_missions(actor, limit=_MISSIONS))).all()
        uploads = (await db.execute(queries.unfinished_uploads(actor, limit=_UPLOADS))).all()
        attention = await _attention(db, actor)
        if _sees_the_server(actor):
            attention = [*await _of_server(db, context.settings), *attention]
    sent = await asyncio.gather(*(_sent_bytes(context, row) for row in uploads))
    return HomeRead(
        missions=[_recent(row) for row in missions],
        uploads=[_unfinished(row, held) for row, held in zip(uploads, sent, strict=True)],
        attention=attention,
    )


async def get_storage(db: Connection, actor: Actor, settings: Settings) -> HomeStorage:
    """Return what is kept. To add it up takes longer than all that `get_home` says."""
    rows = (await db.execute(queries.storage_by_project(actor, limit=_PROJECTS))).all()
    store = await store_use(db, settings) if _sees_the_server(actor) else None
    return HomeStorage(projects=[_storage(row) for row in rows], store=store)


def _sees_the_server(actor: Actor) -> bool:
    return actor.is_admin and actor.limits is None


async def store_use(db: Connection, settings: Settings) -> StoreUse:
    """Return what the store holds, and what is free on its disk where that is on this machine."""
    used = int((await db.execute(queries.used_bytes())).scalar_one())
    free, total = _disk(settings) or (None, None)
    return StoreUse(used_bytes=used, free_bytes=free, disk_bytes=total)


def is_low(settings: Settings) -> bool:
    """Say whether the store's disk is about to be full, where that is on this machine."""
    disk = _disk(settings)
    return disk is not None and disk[0] < max(_LOW_BYTES, _LOW_SHARE * disk[1])


def _disk(settings: Settings) -> tuple[int, int] | None:
    folder = settings.store_folder
    if folder is None or not folder.is_dir():
        return None
    disk = shutil.disk_usage(folder)
    return disk.free, disk.total


async def _attention(db: Connection, actor: Actor) -> list[Attention]:
    ailing = (await db.execute(queries.ailing_files(actor, limit=_AILING))).all()
    lacking = (await db.execute(queries.unsatisfied_missions(actor, limit=_AILING))).all()
    failed = (await db.execute(queries.failed_runs(actor, limit=_AILING))).all()
    counts: dict[tuple[Need, MissionRef], int] = {}
    for row in ailing:
        what = (_OF_STATE.get(row.state) or _OF_CONTENT[row.content], _mission(row))
        counts[what] = counts.get(what, 0) + row.number
    for row in await _runs_that_cannot_start(db, actor):
        what = (Need.runs_cannot_start, _mission(row))
        counts[what] = counts.get(what, 0) + row.number
    found = [Attention(need=need, count=count, mission=where) for (need, where), count in counts.items()]
    found += [Attention(need=Need.runs_failed, count=row.number, mission=_mission(row)) for row in failed]
    found += [Attention(need=Need.metadata_missing, count=row.number, mission=_mission(row)) for row in lacking]
    order = list(Need)
    return sorted(found, key=lambda each: order.index(each.need))


async def _runs_that_cannot_start(db: Connection, actor: Actor) -> list[Row[Any]]:
    queued = (await db.execute(queries.queued_runs(actor, limit=_QUEUED))).all()
    if not queued:
        return []
    known, alone = await known_runners(db), await has_single_person(db)
    return [row for row in queued if reason_never_starts(row, known, single_person=alone) is not None]


async def _of_server(db: Connection, settings: Settings) -> list[Attention]:
    failed = (await db.execute(queries.failed_jobs())).scalar_one()
    late = (await db.execute(queries.overdue_verifications())).scalar_one()
    stopped = (await db.execute(queries.stopped_scrubs(settings.store_id))).scalar_one()
    counts = {
        Need.scrub_stopped: stopped,
        Need.disk_low: int(is_low(settings)),
        Need.jobs_failed: failed,
        Need.verifications_overdue: late,
    }
    return [Attention(need=need, count=count) for need, count in counts.items() if count]


async def _sent_bytes(context: AppContext, row: Row[Any]) -> int | None:
    if row.multipart_id is None:
        return 0 if row.size_bytes > row.part_size_bytes or row.signed_checksum is None else None
    try:
        held = await asyncio.wait_for(context.storage.list_parts(row.key, row.multipart_id), _STORE_PATIENCE_S)
    except (StoreUnavailable, asyncio.TimeoutError):
        return None
    # A part sent twice may be listed twice.
    return sum({part.number: part.size_bytes for part in held or ()}.values())


def _mission(row: Row[Any]) -> MissionRef:
    return MissionRef(id=row.id, name=row.name, project=ProjectRef(id=row.project_id, name=row.project_name))


def _recent(row: Row[Any]) -> RecentMission:
    return RecentMission(
        mission=_mission(row), active_at=row.active_at, file_count=row.files, size_bytes=int(row.size_bytes)
    )


def _unfinished(row: Row[Any], sent_bytes: int | None) -> UnfinishedUpload:
    place = ProjectRef(id=row.project_id, name=row.project_name)
    return UnfinishedUpload(
        id=row.id,
        mission=MissionRef(id=row.mission_id, name=row.mission_name, project=place),
        path=row.path,
        size_bytes=row.size_bytes,
        sent_bytes=sent_bytes,
        created_at=row.created_at,
        expires_at=row.expires_at,
    )


def _storage(row: Row[Any]) -> ProjectStorage:
    return ProjectStorage(
        project=ProjectRef(id=row.id, name=row.name),
        file_count=row.files,
        size_bytes=int(row.size_bytes),
        quota_bytes=row.quota_bytes,
    )
