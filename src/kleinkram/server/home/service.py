"""What home asks of the database: few selects, each of a bounded answer. Functions touch no connection."""

import asyncio
import shutil
from typing import Any

from sqlalchemy import Row, Select, func, select, text, union

from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.files import BlobState
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
from kleinkram.contract.runs import RunState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files, visible_missions, visible_projects
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.missions.amounts import file_amounts
from kleinkram.server.runners.eligibility import Needs, has_single_person, known_runners, reason_never_starts
from kleinkram.server.runs.queries import visible_runs
from kleinkram.server.settings import Settings
from kleinkram.server.tables import action_version, blob, file, mission, project, run, scrub, upload
from kleinkram.server.tables.upload import UNDER_WAY
from kleinkram.server.uploads.queries import own_uploads

# As the index of what ails says it.
_AILS = text("(blob.state IN ('corrupt', 'lost') OR blob.content IN ('broken', 'recovered', 'error'))")
# Among the files that came last, where something arrived; and the missions that were made last.
_LAST_FILES = 2000
_VERIFICATION_DUE_AFTER = text("interval '2 days'")
_SAY_HOW_IT_IS = (RunState.done.value, RunState.failed.value)
_FAILED_LATELY = text("interval '7 days'")


def recent_missions(actor: Actor, *, limit: int) -> Select[Any]:
    """Return the missions in which something arrived last, with when, and what is in them.

    Of those in which one of the last `_LAST_FILES` files arrived, and the last `limit` that were made.
    """
    files = visible_files(actor).with_only_columns(file.c.mission_id, maintain_column_froms=True)
    last = files.order_by(file.c.created_at.desc(), file.c.id.desc()).limit(_LAST_FILES).subquery()
    made = visible_missions(actor).with_only_columns(mission.c.id.label("id"), maintain_column_froms=True)
    newest = made.order_by(mission.c.created_at.desc(), mission.c.id.desc()).limit(limit).subquery()
    chosen = union(select(last.c.mission_id.label("id")), select(newest.c.id)).subquery()
    # Which came last is asked of many missions, what is in them of those few.
    live = file.c.deleted_at.is_(None)
    # A maximum with a filter is looked for in the mission; one without, from the newest file of all on.
    arrived_at = func.max(file.c.created_at).filter(live).label("at")
    arrival = select(arrived_at).where(file.c.mission_id == mission.c.id).lateral()
    active_at = func.greatest(mission.c.created_at, arrival.c.at).label("active_at")
    first = select(mission.c.id, mission.c.name, mission.c.project_id, active_at)
    first = first.join_from(chosen, mission, mission.c.id == chosen.c.id).join(arrival, text("true"))
    active = first.order_by(active_at.desc(), mission.c.id).limit(limit).cte("active").prefix_with("MATERIALIZED")
    counted = (func.count(file.c.id).label("files"), func.coalesce(func.sum(blob.c.size_bytes), 0).label("size_bytes"))
    named = (active.c.id, active.c.name, active.c.project_id, project.c.name.label("project_name"))
    return (
        select(*named, active.c.active_at, *counted)
        .join_from(active, project, project.c.id == active.c.project_id)
        .outerjoin(file, (file.c.mission_id == active.c.id) & live)
        .outerjoin(blob, blob.c.id == file.c.blob_id)
        .group_by(*named, active.c.active_at)
        .order_by(active.c.active_at.desc(), active.c.id)
    )


def unfinished_uploads(actor: Actor, *, limit: int) -> Select[Any]:
    """Return one's own uploads that are under way, the latest first."""
    named = (
        upload.c.created_at,
        mission.c.name.label("mission_name"),
        mission.c.project_id,
        project.c.name.label("project_name"),
    )
    return (
        own_uploads(actor)
        .add_columns(*named)
        .join(mission, mission.c.id == upload.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .where(upload.c.state.in_(UNDER_WAY), upload.c.expires_at > func.now())
        .order_by(upload.c.created_at.desc(), upload.c.id)
        .limit(limit)
    )


def ailing_files(actor: Actor, *, limit: int) -> Select[Any]:
    """Return how many files of each mission are in each state that is not well, most first."""
    named = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
    said = (blob.c.state, blob.c.content)
    stmt = visible_files(actor).with_only_columns(
        *named, *said, func.count().label("number"), maintain_column_froms=True
    )
    stmt = stmt.where(_AILS).group_by(mission.c.id, project.c.id, *said)
    return stmt.order_by(func.count().desc(), mission.c.id).limit(limit)


def unsatisfied_missions(actor: Actor, *, limit: int) -> Select[Any]:
    """Return missions that lack what their project asks for, with the number of problems of each."""
    number = func.jsonb_array_length(mission.c.metadata_problems)
    named = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
    stmt = visible_missions(actor).with_only_columns(*named, number.label("number"), maintain_column_froms=True)
    return stmt.where(number > 0).order_by(mission.c.created_at.desc(), mission.c.id).limit(limit)


def failed_runs(actor: Actor, *, limit: int) -> Select[Any]:
    """Return how many actions failed on each mission in the last days, where that was the last they said, most first.

    An action is the same by its name, so that a script that was mended and run again from its folder counts as well.
    """
    later, its_version = run.alias("later"), action_version.alias("its_version")
    name, later_name = action_version.c.definition["name"], its_version.c.definition["name"]
    said_since = (
        select(later.c.id)
        .join(its_version, its_version.c.id == later.c.version_id)
        .where(later.c.mission_id == run.c.mission_id, later_name == name)
        .where((later.c.created_at > run.c.created_at) & later.c.state.in_(_SAY_HOW_IT_IS))
    )
    named = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
    stmt = visible_runs(actor).with_only_columns(*named, func.count().label("number"), maintain_column_froms=True)
    lately = run.c.ended_at > func.now() - _FAILED_LATELY
    stmt = stmt.where(run.c.state == RunState.failed.value, lately, ~said_since.exists())
    return (
        stmt.group_by(mission.c.id, project.c.id).order_by(func.max(run.c.ended_at).desc(), mission.c.id).limit(limit)
    )


def queued_runs(actor: Actor, *, limit: int) -> Select[Any]:
    """Return what queued runs need of a runner, under the names of `Needs`, and how many do so on each mission."""
    needs = [run.c[name] for name in Needs._fields if name != "project_id"]
    named = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
    number = func.count().label("number")
    stmt = visible_runs(actor).with_only_columns(*named, *needs, number, maintain_column_froms=True)
    stmt = stmt.where(run.c.state == RunState.queued.value).group_by(mission.c.id, project.c.id, *needs)
    return stmt.order_by(number.desc(), mission.c.id).limit(limit)


def storage_by_project(actor: Actor, *, limit: int) -> Select[Any]:
    """Return what is kept in each project that somebody sees, the largest first."""
    files, in_bytes = file_amounts(actor)
    inside = visible_missions(actor).with_only_columns(
        mission.c.project_id,
        func.sum(files).label("files"),
        func.sum(in_bytes).label("size_bytes"),
        maintain_column_froms=True,
    )
    sums = inside.group_by(mission.c.project_id).subquery()
    size_bytes = func.coalesce(sums.c.size_bytes, 0)
    stmt = visible_projects(actor).with_only_columns(
        project.c.id,
        project.c.name,
        project.c.quota_bytes,
        func.coalesce(sums.c.files, 0).label("files"),
        size_bytes.label("size_bytes"),
        maintain_column_froms=True,
    )
    stmt = stmt.outerjoin(sums, sums.c.project_id == project.c.id)
    return stmt.order_by(size_bytes.desc(), project.c.name, project.c.id).limit(limit)


def used_bytes() -> Select[Any]:
    """Return how many bytes the store keeps, each once."""
    return select(func.coalesce(func.sum(blob.c.size_bytes), 0)).where(blob.c.doomed_at.is_(None))


def overdue_verifications() -> Select[Any]:
    """Return how many files' bytes should have been verified by now."""
    late = (blob.c.state == BlobState.stored.value, blob.c.doomed_at.is_(None))
    return select(func.count()).select_from(blob).where(*late, blob.c.created_at < func.now() - _VERIFICATION_DUE_AFTER)


def stopped_scrubs(store_id: str) -> Select[Any]:
    """Return whether the last comparison of the store with the database that ended did not go through: 1, or 0."""
    ended = select(scrub.c.stopped).where(scrub.c.store_id == store_id, scrub.c.ended_at.is_not(None))
    last = ended.order_by(scrub.c.created_at.desc()).limit(1).subquery()
    return select(func.count(last.c.stopped))


def failed_jobs() -> Select[Any]:
    """Return how many jobs were given up."""
    return select(func.count()).select_from(text("procrastinate_jobs")).where(text("status = 'failed'"))


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
        missions = (await db.execute(recent_missions(actor, limit=_MISSIONS))).all()
        uploads = (await db.execute(unfinished_uploads(actor, limit=_UPLOADS))).all()
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
    rows = (await db.execute(storage_by_project(actor, limit=_PROJECTS))).all()
    store = await store_use(db, settings) if _sees_the_server(actor) else None
    return HomeStorage(projects=[_storage(row) for row in rows], store=store)


def _sees_the_server(actor: Actor) -> bool:
    return actor.is_admin and actor.limits is None


async def store_use(db: Connection, settings: Settings) -> StoreUse:
    """Return what the store holds, and what is free on its disk where that is on this machine."""
    used = int((await db.execute(used_bytes())).scalar_one())
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
    ailing = (await db.execute(ailing_files(actor, limit=_AILING))).all()
    lacking = (await db.execute(unsatisfied_missions(actor, limit=_AILING))).all()
    failed = (await db.execute(failed_runs(actor, limit=_AILING))).all()
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
    queued = (await db.execute(queued_runs(actor, limit=_QUEUED))).all()
    if not queued:
        return []
    known, alone = await known_runners(db), await has_single_person(db)
    return [row for row in queued if reason_never_starts(row, known, single_person=alone) is not None]


async def _of_server(db: Connection, settings: Settings) -> list[Attention]:
    failed = (await db.execute(failed_jobs())).scalar_one()
    late = (await db.execute(overdue_verifications())).scalar_one()
    stopped = (await db.execute(stopped_scrubs(settings.store_id))).scalar_one()
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
