"""The status of the server in one answer: is it healthy, what is full, when will it be, and what needs an admin."""

import datetime
from collections.abc import Iterator
from typing import Any, NamedTuple

from sqlalchemy import func, select

import kleinkram
from kleinkram.contract.access import TokenKind
from kleinkram.contract.admin import (
    AdminHealth,
    AdminStatus,
    CapacityForecast,
    CapacityUnit,
    StatusItem,
    StatusSeverity,
)
from kleinkram.contract.files import BlobState
from kleinkram.contract.home import Attention, AttentionKind
from kleinkram.contract.units import format_size
from kleinkram.diagnostics import check_clock, find_problems, is_disk_low
from kleinkram.server.admin.capacity import bytes_per_day, quota_capacities, store_capacity
from kleinkram.server.admin.service import get_health
from kleinkram.server.blobs import scrub
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection
from kleinkram.server.health.instance_metrics import BackupAttempt, last_backups
from kleinkram.server.health.readiness import ALIVE_WITHIN
from kleinkram.server.home.service import server_attention, store_use
from kleinkram.server.jobs.queue import PREVIEWS, queue_ages_s
from kleinkram.server.settings import Settings
from kleinkram.server.tables import token, worker_process

_QUEUE_LATE_S = 900
_NEARLY_FULL = 0.9
_FULL_SOON = datetime.timedelta(days=30)
_EXPIRES_SOON = datetime.timedelta(days=14)
# A scrub is late when two were left out.
_SCRUBS_MISSED = 3
_MINUTE_S, _HOUR_S = 60, 3600
# As the alert KleinkramBackupOld.
_BACKUP_LATE = datetime.timedelta(hours=36)
_BACKUP_REMEDY = "Run `klein backup create LOCATION`, and see why the scheduled one does not."


class _Text(NamedTuple):
    subject: str
    severity: StatusSeverity
    message: str
    remedy: str


# What the home page counts; a full disk is among the capacities.
_ATTENTION = {
    AttentionKind.scrub_stopped: _Text(
        "scrub",
        StatusSeverity.problem,
        "The last scrub stopped and marked nothing.",
        "`klein admin scrub --last` shows the reason.",
    ),
    AttentionKind.jobs_failed: _Text(
        "jobs",
        StatusSeverity.warning,
        "Jobs that failed permanently: {count}.",
        "`klein admin jobs` shows the reasons; `klein admin retry --all` queues them again.",
    ),
    AttentionKind.verifications_overdue: _Text(
        "verification",
        StatusSeverity.warning,
        "Blobs that were stored more than two days ago and are not verified: {count}.",
        "Start another worker, or raise KLEINKRAM_VERIFY_BYTES_PER_S.",
    ),
}


async def get_status(context: AppContext, *, takes_pages: bool = True) -> AdminStatus:
    """Return the status. `takes_pages`: whether the store accepts uploads of browsers, as the API found at its start.

    Raises DatabaseUnavailable.
    """
    health = await get_health(context, takes_pages=takes_pages)
    settings = context.settings
    if health.not_ready is not None:
        # The other questions need a schema that this program knows; the store may be the part that is away.
        items = [_problem("service", health.not_ready, "`python -m kleinkram.server check` names the remedy.")]
    else:
        items = [*_health_items(health)]
    async with context.database.begin() as db:
        store, per_day = await store_use(db, settings), await bytes_per_day(db)
        capacities = await quota_capacities(db, health.now)
        of_store = store_capacity(store, per_day, health.now)
        capacities += [] if of_store is None else [of_store]
        items += await _database_items(db, settings)
        items += _backup_items(*await last_backups(db), health.now)
    never = datetime.datetime.max.replace(tzinfo=datetime.timezone.utc)
    capacities.sort(key=lambda row: (row.full_at or never, -row.used / max(1, row.limit)))
    items += _capacity_items(capacities, health.now)
    items.sort(key=lambda item: item.severity is not StatusSeverity.problem)  # stable
    return AdminStatus(
        now=health.now,
        version=health.version,
        is_healthy=not any(item.severity is StatusSeverity.problem for item in items),
        items=items,
        stored_bytes=store.used_bytes,
        stored_bytes_per_day=per_day,
        capacities=capacities,
    )


def _health_items(health: AdminHealth) -> Iterator[StatusItem]:
    make = _warning if health.workers_at else _problem  # without a worker, nothing is read or verified
    yield from (make("workers", text) for text in health.warnings)
    for result in find_problems([check_clock("clock", health.clock_skew_s)]):
        yield _warning("clock", f"{result.message} (This server and the database.)", result.remedy)
    if health.runs_problem is not None:
        yield _warning("runs", health.runs_problem)
    if health.invitation_warning is not None:
        yield _warning("invitations", health.invitation_warning)
    if not health.store_allows_browser_uploads:
        remedy = "Correct the CORS rules of the bucket, then restart the API."
        yield _warning("store", "Browsers cannot upload or show previews.", remedy)


async def _database_items(db: Connection, settings: Settings) -> list[StatusItem]:
    attention = await server_attention(db, settings)
    items = [_attention_item(one) for one in attention if one.kind in _ATTENTION]
    items += [
        _problem(
            "files",
            f"Blobs that are {row.state}: {row.number} ({format_size(row.size_bytes)}).",
            f"`klein file list --state {row.state}` lists their files: upload them again, or restore them from a "
            "backup.",
        )
        for row in await scrub.blobs_by_state(db)
        if row.state in {BlobState.lost.value, BlobState.corrupt.value}
    ]
    ages_s = await queue_ages_s(db)
    age_s = max((age_s for name, age_s in ages_s.items() if name != PREVIEWS), default=0.0)
    if age_s > _QUEUE_LATE_S:
        message = f"The oldest job has been waiting for {age_s / _MINUTE_S:.0f} min."
        items.append(_warning("jobs", message, "`klein admin jobs` shows the queue; start another worker."))
    items += await _scrub_items(db, settings)
    items += await _version_items(db)
    items += await _token_items(db)
    return items


def _attention_item(attention: Attention) -> StatusItem:
    text = _ATTENTION[attention.kind]
    message = text.message.format(count=attention.count)
    return StatusItem(severity=text.severity, subject=text.subject, message=message, remedy=text.remedy)


async def _scrub_items(db: Connection, settings: Settings) -> list[StatusItem]:
    last = await scrub.last_scrub(db, settings.store_id)
    if not settings.scrub_hours or last is None:
        return []
    ended_or_seen = last.ended_at or last.seen_at or last.created_at
    silent_s = (last.now - ended_or_seen).total_seconds()
    if silent_s < _SCRUBS_MISSED * settings.scrub_hours * _HOUR_S:
        return []
    message = f"The store was last compared with the database {silent_s / _HOUR_S:.0f} hours ago."
    return [_warning("scrub", message, "`klein admin scrub` starts a comparison; check that a worker runs.")]


def _backup_items(
    last: BackupAttempt | None, complete: BackupAttempt | None, now: datetime.datetime
) -> Iterator[StatusItem]:
    if complete is None:
        yield _warning("backup", "No backup was made yet.", "`klein backup create LOCATION` makes one; schedule it.")
    elif now - complete.started_at > _BACKUP_LATE:
        hours = (now - complete.started_at).total_seconds() / _HOUR_S
        yield _problem("backup", f"The last complete backup is {hours:.0f} hours old.", _BACKUP_REMEDY)
    if last is not None and last.snapshot_id is None:
        yield _warning("backup", f"The last backup failed at {last.ended_at:%Y-%m-%d %H:%M} UTC.", _BACKUP_REMEDY)


async def _version_items(db: Connection) -> list[StatusItem]:
    """Return whether workers run another version: an upgrade that was not finished."""
    process = worker_process.c
    is_alive = process.ended_at.is_(None) & (process.seen_at > func.now() - ALIVE_WITHIN)
    stmt = select(process.version, func.count().label("number")).where(is_alive).group_by(process.version)
    others = [row for row in await db.execute(stmt) if row.version != kleinkram.__version__]
    return [
        _warning(
            "version",
            f"Workers of version {row.version}: {row.number}; this program is version {kleinkram.__version__}.",
            "Restart what runs the older version.",
        )
        for row in others
    ]


async def _token_items(db: Connection) -> list[StatusItem]:
    """Return which tokens of runners expire soon: their runners stop then."""
    is_used = (token.c.kind == TokenKind.runner.value) & token.c.revoked_at.is_(None)
    ends = token.c.expires_at.between(func.now(), func.now() + _EXPIRES_SOON)
    stmt = select(token.c.name, token.c.expires_at).where(is_used, ends).order_by(token.c.expires_at)
    rows: list[Any] = [*await db.execute(stmt)]
    remedy = "Create another one, and restart its runner with it."
    return [
        _warning("runners", f"The token {row.name} of a runner expires on {row.expires_at:%Y-%m-%d}.", remedy)
        for row in rows
    ]


def _capacity_items(capacities: list[CapacityForecast], now: datetime.datetime) -> Iterator[StatusItem]:
    for row in capacities:
        share = row.used / row.limit if row.limit else 1.0
        is_low = row.project is None and is_disk_low(row.limit - row.used, row.limit)
        is_soon = row.full_at is not None and row.full_at < now + _FULL_SOON
        if not (share >= _NEARLY_FULL or is_low or is_soon):
            continue
        name = "The store" if row.project is None else f"The quota of {row.project.name}"
        text = f"{name} is {min(share, 1):.0%} full ({describe_use(row)})"
        if row.used >= row.limit or is_low:
            yield _problem("capacity", f"{text}: uploads fail, or soon will.", _remedy(row))
        else:
            when = f", and will be full on {row.full_at:%Y-%m-%d}" if row.full_at is not None else ""
            yield _warning("capacity", f"{text}{when}.", _remedy(row))


def describe_use(row: CapacityForecast) -> str:
    """Return the use and the limit: `3.0 GB of 10.0 GB`, `3 of 10 files`."""
    if row.unit is CapacityUnit.files:
        return f"{row.used} of {row.limit} files"
    return f"{format_size(row.used)} of {format_size(row.limit)}"


def _remedy(row: CapacityForecast) -> str:
    return "Delete files, or add disk space." if row.project is None else "Delete files, or raise the quota."


def _problem(subject: str, message: str, remedy: str = "") -> StatusItem:
    return StatusItem(severity=StatusSeverity.problem, subject=subject, message=message, remedy=remedy)


def _warning(subject: str, message: str, remedy: str = "") -> StatusItem:
    return StatusItem(severity=StatusSeverity.warning, subject=subject, message=message, remedy=remedy)
