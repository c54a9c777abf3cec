"""The home page: recent missions, unfinished uploads, what needs attention, and storage. Every list is bounded."""

import asyncio
import datetime
import shutil
import uuid
from typing import Any, NamedTuple

from sqlalchemy import Select, false, func, select, text, true, union

from kleinkram.contract.checks import Verdict
from kleinkram.contract.errors import StoreUnavailable
from kleinkram.contract.files import BlobState
from kleinkram.contract.home import (
    Attention,
    AttentionKind,
    FailedChecks,
    HomeRead,
    HomeStorage,
    ProjectStorage,
    RecentMission,
    StoreUse,
    UnfinishedUpload,
)
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.runs import RunState
from kleinkram.diagnostics import is_disk_low
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions, visible_files, visible_missions, visible_projects
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.filters.verdicts import is_current, join_checks
from kleinkram.server.missions.queries import file_totals, mission_ref
from kleinkram.server.runs.eligibility import NEEDS_COLUMNS, known_runners, to_needs
from kleinkram.server.runs.queries import visible_runs
from kleinkram.server.settings import Settings
from kleinkram.server.tables import action_version, blob, file, mission, mission_checks, project, run, scrub, upload
from kleinkram.server.tables.blobs import UNDER_WAY
from kleinkram.server.uploads.queries import own_uploads

_MAX_MISSIONS, _MAX_ITEMS = 10, 20
# Kinds of queued runs that are checked; one kind is one action on one mission.
_MAX_QUEUED = 200
# Recent missions are those of the newest so many files, and the newest ones themselves.
_LAST_FILES = 2000
_STORE_TIMEOUT_S = 2.0
_OF_STATE = {"corrupt": AttentionKind.files_corrupt, "lost": AttentionKind.files_lost}
_OF_CONTENT = {
    "broken": AttentionKind.files_broken,
    "error": AttentionKind.files_unread,
    "recovered": AttentionKind.files_recovered,
}
# In the words of the partial index.
_IS_DAMAGED = text("(blob.state IN ('corrupt', 'lost') OR blob.content IN ('broken', 'recovered', 'error'))")
_VERIFICATION_DUE_AFTER = text("interval '2 days'")
_FAILURES_WITHIN = text("interval '7 days'")
_FINISHED = (RunState.done.value, RunState.failed.value)
# The arguments of `mission_ref`.
_MISSION = (mission.c.id, mission.c.name, mission.c.project_id, project.c.name.label("project_name"))
_NUMBER = func.count().label("number")


class _StartedUpload(NamedTuple):
    """An unfinished upload of the actor, and its mission."""

    id: uuid.UUID
    path: str
    key: str
    size_bytes: int
    part_size_bytes: int
    multipart_id: str | None
    signed_checksum: bytes | None
    created_at: datetime.datetime
    expires_at: datetime.datetime
    mission_id: uuid.UUID
    mission_name: str
    project_id: uuid.UUID
    project_name: str


async def get_home(context: AppContext, actor: Actor) -> HomeRead:
    """Return the home page of an actor. If the store does not answer, only the bytes sent of uploads are missing."""
    async with context.database.begin() as db:
        missions = (await db.execute(_recent_missions(actor))).all()
        uploads = [_StartedUpload._make(row) for row in await db.execute(_unfinished_uploads(actor))]
        attention = await _attention(db, actor, context.settings)
        failed_checks = await _failed_checks(db, actor)
        if _sees_server(actor):
            attention = [*await server_attention(db, context.settings), *attention]
    sent = await asyncio.gather(*(_sent_bytes(context, one) for one in uploads))
    return HomeRead(
        missions=[
            RecentMission(
                mission=mission_ref(row.id, row.name, row.project_id, row.project_name),
                active_at=row.active_at,
                file_count=row.files,
                size_bytes=int(row.size_bytes),
            )
            for row in missions
        ],
        uploads=[
            UnfinishedUpload(
                id=one.id,
                mission=mission_ref(one.mission_id, one.mission_name, one.project_id, one.project_name),
                path=one.path,
                size_bytes=one.size_bytes,
                sent_bytes=sent_bytes,
                created_at=one.created_at,
                expires_at=one.expires_at,
            )
            for one, sent_bytes in zip(uploads, sent, strict=True)
        ],
        attention=attention,
        failed_checks=failed_checks,
    )


async def get_storage(db: Connection, actor: Actor, settings: Settings) -> HomeStorage:
    """Return the size of the largest projects and, for admins, of the store."""
    projects = [
        ProjectStorage(
            project=ProjectRef(id=row.id, name=row.name),
            file_count=row.files,
            size_bytes=int(row.size_bytes),
            quota_bytes=row.quota_bytes,
        )
        for row in await db.execute(_storage_by_project(actor))
    ]
    return HomeStorage(projects=projects, store=await store_use(db, settings) if _sees_server(actor) else None)


async def store_use(db: Connection, settings: Settings) -> StoreUse:
    """Return the bytes in the store, each counted once, and the free bytes: of its disk, or by the given capacity."""
    stmt = select(func.coalesce(func.sum(blob.c.size_bytes), 0)).where(blob.c.marked_for_deletion_at.is_(None))
    used, capacity = int((await db.execute(stmt)).scalar_one()), settings.store_capacity_bytes
    free, total = _disk(settings) or (None, None)
    if total is None and capacity is not None:
        free, total = max(0, capacity - used), capacity
    return StoreUse(used_bytes=used, free_bytes=free, disk_bytes=total)


def is_low(settings: Settings) -> bool:
    """Whether the store's disk, if it is on this machine, is almost full."""
    disk = _disk(settings)
    return disk is not None and is_disk_low(*disk)


def _sees_server(actor: Actor) -> bool:
    return actor.is_admin and actor.limits is None


def _disk(settings: Settings) -> tuple[int, int] | None:
    if settings.store_folder is None or not settings.store_folder.is_dir():
        return None
    disk = shutil.disk_usage(settings.store_folder)
    return disk.free, disk.total


async def _attention(db: Connection, actor: Actor, settings: Settings) -> list[Attention]:
    counts: dict[tuple[AttentionKind, MissionRef], int] = {}

    def count(kind: AttentionKind, number: int, *mission_columns: Any) -> None:  # Any: the arguments of `mission_ref`
        key = (kind, mission_ref(*mission_columns))
        counts[key] = counts.get(key, 0) + number

    for *mission_columns, state, content, number in await db.execute(_damaged_files(actor)):
        count(_OF_STATE.get(state) or _OF_CONTENT[content], number, *mission_columns)
    queued = (await db.execute(_queued_runs(actor))).all()
    if queued:
        known = await known_runners(db, settings.weakest_isolation)
        for row in queued:
            if known.reason_never_starts(to_needs(row._mapping)) is not None:
                count(AttentionKind.runs_cannot_start, row.number, *row[: len(_MISSION)])
    for *mission_columns, number in await db.execute(_failed_runs(actor)):
        count(AttentionKind.runs_failed, number, *mission_columns)
    for *mission_columns, number in await db.execute(_unsatisfied_missions(actor)):
        count(AttentionKind.metadata_missing, number, *mission_columns)
    items = [Attention(kind=kind, count=number, mission=where) for (kind, where), number in counts.items()]
    order = list(AttentionKind)
    return sorted(items, key=lambda attention: order.index(attention.kind))


async def _failed_checks(db: Connection, actor: Actor) -> FailedChecks:
    today = datetime.datetime.now(datetime.timezone.utc).replace(hour=0, minute=0, second=0, microsecond=0)
    since = today - datetime.timedelta(days=today.weekday())
    stmt = join_checks(visible_missions(actor).with_only_columns(*_MISSION, maintain_column_froms=True))
    failed = stmt.where(
        true() if sees_whole_missions(actor) else false(),
        mission_checks.c.verdict == Verdict.bad.value,
        is_current(),
        mission_checks.c.bad_since >= since,
    )
    count = (await db.execute(select(func.count()).select_from(failed.subquery()))).scalar_one()
    latest = failed.order_by(mission_checks.c.bad_since.desc(), mission.c.id).limit(_MAX_MISSIONS)
    missions = [mission_ref(*row) for row in await db.execute(latest)] if count else []
    return FailedChecks(since=since, count=count, missions=missions)


async def server_attention(db: Connection, settings: Settings) -> list[Attention]:
    """Return what needs attention on the whole server."""
    ended = select(scrub.c.aborted_reason).where(scrub.c.store_id == settings.store_id, scrub.c.ended_at.is_not(None))
    last = ended.order_by(scrub.c.created_at.desc()).limit(1).subquery()
    failed_jobs = select(func.count()).select_from(text("procrastinate_jobs")).where(text("status = 'failed'"))
    unverified = (blob.c.state == BlobState.stored.value) & blob.c.marked_for_deletion_at.is_(None)
    is_overdue = unverified & (blob.c.created_at < func.now() - _VERIFICATION_DUE_AFTER)
    overdue = select(func.count()).select_from(blob).where(is_overdue)
    counts = {
        AttentionKind.scrub_stopped: (await db.execute(select(func.count(last.c.aborted_reason)))).scalar_one(),
        AttentionKind.disk_low: int(is_low(settings)),
        AttentionKind.jobs_failed: (await db.execute(failed_jobs)).scalar_one(),
        AttentionKind.verifications_overdue: (await db.execute(overdue)).scalar_one(),
    }
    return [Attention(kind=kind, count=number) for kind, number in counts.items() if number]


async def _sent_bytes(context: AppContext, started: _StartedUpload) -> int | None:
    if started.multipart_id is None:
        return 0 if started.size_bytes > started.part_size_bytes or started.signed_checksum is None else None
    try:
        parts = await asyncio.wait_for(context.storage.list_parts(started.key, started.multipart_id), _STORE_TIMEOUT_S)
    except (StoreUnavailable, asyncio.TimeoutError):
        return None
    # A part that was sent twice may be listed twice.
    return sum({part.number: part.size_bytes for part in parts or ()}.values())


def _recent_missions(actor: Actor) -> Select[Any]:
    files = visible_files(actor).with_only_columns(file.c.mission_id, maintain_column_froms=True)
    last = files.order_by(file.c.created_at.desc(), file.c.id.desc()).limit(_LAST_FILES).subquery()
    missions = visible_missions(actor).with_only_columns(mission.c.id.label("id"), maintain_column_froms=True)
    newest = missions.order_by(mission.c.created_at.desc(), mission.c.id.desc()).limit(_MAX_MISSIONS).subquery()
    candidates = union(select(last.c.mission_id.label("id")), select(newest.c.id)).subquery()
    # First find the most recent missions, then count the files of those few.
    live = file.c.deleted_at.is_(None)
    # A maximum with a filter reads the mission's index; without one, PostgreSQL walks back from the newest file of all.
    arrived_at = func.max(file.c.created_at).filter(live).label("at")
    arrival = select(arrived_at).where(file.c.mission_id == mission.c.id).lateral()
    active_at = func.greatest(mission.c.created_at, arrival.c.at).label("active_at")
    recent = select(mission.c.id, mission.c.name, mission.c.project_id, active_at)
    recent = recent.join_from(candidates, mission, mission.c.id == candidates.c.id).join(arrival, text("true"))
    recent = recent.order_by(active_at.desc(), mission.c.id).limit(_MAX_MISSIONS)
    active = recent.cte("active").prefix_with("MATERIALIZED")
    counts = (func.count(file.c.id).label("files"), func.coalesce(func.sum(blob.c.size_bytes), 0).label("size_bytes"))
    names = (active.c.id, active.c.name, active.c.project_id, project.c.name.label("project_name"))
    return (
        select(*names, active.c.active_at, *counts)
        .join_from(active, project, project.c.id == active.c.project_id)
        .outerjoin(file, (file.c.mission_id == active.c.id) & live)
        .outerjoin(blob, blob.c.id == file.c.blob_id)
        .group_by(*names, active.c.active_at)
        .order_by(active.c.active_at.desc(), active.c.id)
    )


def _unfinished_uploads(actor: Actor) -> Select[Any]:
    own = [upload.c[name] for name in _StartedUpload._fields if name in upload.c]
    mission_columns = (mission.c.name, mission.c.project_id, project.c.name)
    return (
        own_uploads(actor)
        .with_only_columns(*own, *mission_columns, maintain_column_froms=True)
        .join(mission, mission.c.id == upload.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .where(upload.c.state.in_(UNDER_WAY), upload.c.expires_at > func.now())
        .order_by(upload.c.created_at.desc(), upload.c.id)
        .limit(_MAX_ITEMS)
    )


def _damaged_files(actor: Actor) -> Select[Any]:
    condition = (blob.c.state, blob.c.content)
    stmt = visible_files(actor).with_only_columns(*_MISSION, *condition, _NUMBER, maintain_column_froms=True)
    stmt = stmt.where(_IS_DAMAGED).group_by(mission.c.id, project.c.id, *condition)
    return stmt.order_by(func.count().desc(), mission.c.id).limit(_MAX_ITEMS)


def _unsatisfied_missions(actor: Actor) -> Select[Any]:
    number = func.jsonb_array_length(mission.c.metadata_problems)
    stmt = visible_missions(actor).with_only_columns(*_MISSION, number.label("number"), maintain_column_froms=True)
    return stmt.where(number > 0).order_by(mission.c.created_at.desc(), mission.c.id).limit(_MAX_ITEMS)


def _failed_runs(actor: Actor) -> Select[Any]:
    """Return the recent failures on each mission that are the last result of their action.

    Actions are identified by name, so that a script that was corrected and run from its folder again counts too.
    """
    later, later_version = run.alias("later"), action_version.alias("its_version")
    name, later_name = action_version.c.definition["name"], later_version.c.definition["name"]
    later_result = (
        select(later.c.id)
        .join(later_version, later_version.c.id == later.c.version_id)
        .where(later.c.mission_id == run.c.mission_id, later_name == name)
        .where((later.c.created_at > run.c.created_at) & later.c.state.in_(_FINISHED))
    )
    stmt = visible_runs(actor).with_only_columns(*_MISSION, _NUMBER, maintain_column_froms=True)
    is_recent = run.c.ended_at > func.now() - _FAILURES_WITHIN
    stmt = stmt.where(run.c.state == RunState.failed.value, is_recent, ~later_result.exists())
    last_first = func.max(run.c.ended_at).desc()
    return stmt.group_by(mission.c.id, project.c.id).order_by(last_first, mission.c.id).limit(_MAX_ITEMS)


def _queued_runs(actor: Actor) -> Select[Any]:
    """Return the number of queued runs on each mission by what they need of a runner, named as in `Needs`."""
    needs = [column for column in NEEDS_COLUMNS if column is not mission.c.project_id]  # which is in `_MISSION`
    stmt = visible_runs(actor).with_only_columns(*_MISSION, *needs, _NUMBER, maintain_column_froms=True)
    stmt = stmt.where(run.c.state == RunState.queued.value).group_by(mission.c.id, project.c.id, *needs)
    return stmt.order_by(_NUMBER.desc(), mission.c.id).limit(_MAX_QUEUED)


def _storage_by_project(actor: Actor) -> Select[Any]:
    files, in_bytes = file_totals(actor)
    inside = visible_missions(actor).with_only_columns(
        mission.c.project_id,
        func.sum(files).label("files"),
        func.sum(in_bytes).label("size_bytes"),
        maintain_column_froms=True,
    )
    sums = inside.group_by(mission.c.project_id).subquery()
    size_bytes = func.coalesce(sums.c.size_bytes, 0)
    columns = project.c.id, project.c.name, project.c.quota_bytes, func.coalesce(sums.c.files, 0).label("files")
    stmt = visible_projects(actor).with_only_columns(
        *columns, size_bytes.label("size_bytes"), maintain_column_froms=True
    )
    stmt = stmt.outerjoin(sums, sums.c.project_id == project.c.id)
    return stmt.order_by(size_bytes.desc(), project.c.name, project.c.id).limit(_MAX_ITEMS)
