"""How fast the store and the quotas of projects fill, and when they will be full.

The rate is what was added in the last 30 days and still exists. What was deleted in that time is not counted, so that a
store whose old files are deleted as fast as new ones arrive is reported as full too early, never too late.
"""

import datetime
from typing import Any

from sqlalchemy import ColumnElement, Select, func, select

from kleinkram.contract.admin import CapacityForecast, CapacityUnit
from kleinkram.contract.home import StoreUse
from kleinkram.contract.projects import ProjectRef
from kleinkram.server.db import Connection
from kleinkram.server.tables import blob, file, mission, person, project

_WINDOW_DAYS = 30.0
# Of a project that was made an hour ago, an hour is no measure.
_MIN_DAYS = 1.0
_HORIZON_DAYS = 3650.0
_DAY_S = 86_400


async def bytes_per_day(db: Connection) -> int:
    """Return the bytes that the store gains in a day; files with the same bytes count once."""
    began_at = select(func.min(person.c.created_at)).scalar_subquery()
    added = func.coalesce(func.sum(blob.c.size_bytes), 0) / _days_since(began_at)
    stmt = select(added).where(blob.c.marked_for_deletion_at.is_(None), _is_recent(blob.c.created_at))
    return int((await db.execute(stmt)).scalar_one())


async def quota_capacities(db: Connection, now: datetime.datetime) -> list[CapacityForecast]:
    """Return the quotas of all projects and when they will be full."""
    capacities = []
    for row in await db.execute(_quotas()):
        ref = ProjectRef(id=row.id, name=row.name)
        for unit, limit in ((CapacityUnit.bytes, row.quota_bytes), (CapacityUnit.files, row.quota_files)):
            if limit is not None:
                used, per_day = int(getattr(row, unit.value)), float(getattr(row, f"{unit.value}_per_day"))
                capacities.append(forecast(ref, unit, used=used, limit=limit, per_day=per_day, now=now))
    return capacities


def store_capacity(store: StoreUse, per_day: int, now: datetime.datetime) -> CapacityForecast | None:
    """Return when the store will be full; None if its size is not known."""
    if store.disk_bytes is None or store.free_bytes is None:
        return None
    used = store.disk_bytes - store.free_bytes
    return forecast(None, CapacityUnit.bytes, used=used, limit=store.disk_bytes, per_day=per_day, now=now)


def forecast(
    ref: ProjectRef | None, unit: CapacityUnit, *, used: int, limit: int, per_day: float, now: datetime.datetime
) -> CapacityForecast:
    """Return a limit with the time at which it will be reached at a constant rate, also one of few files a month."""
    full_at = None
    if used >= limit:
        full_at = now
    elif per_day > 0 and (days := (limit - used) / per_day) <= _HORIZON_DAYS:
        full_at = now + datetime.timedelta(days=days)
    return CapacityForecast(project=ref, unit=unit, used=used, limit=limit, per_day=round(per_day), full_at=full_at)


def _quotas() -> Select[Any]:
    """Select the use and the rates of projects with a quota, as `quotas.require_room` counts but without uploads."""
    is_live_mission = (mission.c.project_id == project.c.id) & mission.c.deleted_at.is_(None)
    is_live_file = (file.c.mission_id == mission.c.id) & file.c.deleted_at.is_(None)
    recent = _is_recent(file.c.created_at)
    size_bytes, days = func.coalesce(func.sum(blob.c.size_bytes), 0), _days_since(project.c.created_at)
    recent_bytes = func.coalesce(func.sum(blob.c.size_bytes).filter(recent), 0)
    return (
        select(
            project.c.id,
            project.c.name,
            project.c.quota_bytes,
            project.c.quota_files,
            size_bytes.label("bytes"),
            func.count(file.c.id).label("files"),
            (recent_bytes / days).label("bytes_per_day"),
            (func.count(file.c.id).filter(recent) / days).label("files_per_day"),
        )
        .select_from(project)
        .outerjoin(mission, is_live_mission)
        .outerjoin(file, is_live_file)
        .outerjoin(blob, blob.c.id == file.c.blob_id)
        .where(project.c.deleted_at.is_(None), project.c.quota_bytes.is_not(None) | project.c.quota_files.is_not(None))
        .group_by(project.c.id)
        .order_by(project.c.name)
    )


def _is_recent(at: ColumnElement[Any]) -> ColumnElement[bool]:
    return at > func.now() - datetime.timedelta(days=_WINDOW_DAYS)


def _days_since(at: ColumnElement[Any]) -> ColumnElement[Any]:
    """Return the days since a time, but at least one and at most the window."""
    days = func.extract("epoch", func.now() - at) / _DAY_S
    return func.least(_WINDOW_DAYS, func.greatest(_MIN_DAYS, days))
