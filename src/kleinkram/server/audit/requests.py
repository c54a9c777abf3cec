"""Audit entries for requests that change nothing: refusals, and reads that only admin rights allow.

Each is written in a transaction of its own: that of a refused request is rolled back, and a read has none.

Anybody can cause refusals at any rate, so each process audits at most `PER_MINUTE` of them a minute per known actor,
and as many of all guests together; one entry at the end of the minute counts the rest. The request log has them all.
No token is ever recorded, nor anything else from the request except its address.

Reads by admins are audited once an hour for each object (decision 14), before the response is sent. A process caches
for a minute what it has checked, so that paging through a list costs one check.
"""

import asyncio
import datetime
import logging
import time
import uuid
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.access import Right
from kleinkram.contract.errors import DatabaseUnavailable, ErrorCode
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import STRANGER, Actor
from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from kleinkram.server.access.visible import level_on_mission, level_on_project
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Database, among
from kleinkram.server.tables import (
    access_group,
    audit_event,
    file,
    membership,
    mission,
    mission_event,
    person,
    project,
    recording,
    upload,
)

PER_MINUTE = 20
MINUTE_S = 60.0
_ADMIN_READ = "admin.read"
# Refusals with a status other than 401 and 403, and their operation in the audit log.
OTHER_REFUSALS = {
    ErrorCode.rate_limited: "rate.limited",
    ErrorCode.code_gone: "auth.refused",
    ErrorCode.sign_in_expired: "auth.refused",
}
_log = logging.getLogger("kleinkram.audit")
_READ_INTERVAL = datetime.timedelta(hours=1)
_CACHED_S = 60
_MAX_CACHED = 10_000
# Operations on people and groups, which are outside of projects.
_ON_PEOPLE = frozenset({"list_people", "list_groups", "get_person", "get_group", "list_group_members"})
# Shows nothing without a link.
_BY_LINK = frozenset({"get_share"})
# Parameters of requests: of objects in a mission, and of objects outside projects.
_INSIDE = {"file_id": file, "recording_id": recording, "upload_id": upload, "event_id": mission_event}
_OUTSIDE = {"person_id": person, "group_id": access_group}
_INVALID_ID = uuid.UUID(int=0)
_OBJECT_COLUMNS = ("resource_type", "resource_id", "resource_name", "project_id", "mission_id")


class RequestTarget(NamedTuple):
    """The object that a request names: the name of the parameter, and the id."""

    kind: str
    id: uuid.UUID


def request_target(path: Mapping[str, object], query: Mapping[str, str]) -> RequestTarget | None:
    """Return the innermost object in a request's path, else in its query; None if the request is about everything."""
    parameters = {name: query[name] for name in ("project_id", "mission_id") if name in query}
    parameters |= {name: str(value) for name, value in path.items()}
    kind = next((name for name in (*_INSIDE, "mission_id", "project_id", *_OUTSIDE) if name in parameters), None)
    if kind is None:
        return None
    try:
        return RequestTarget(kind, uuid.UUID(parameters[kind]))
    except ValueError:
        return RequestTarget(kind, _INVALID_ID)


def _target_object(target: RequestTarget) -> sa.Select[Any]:
    """Return `_OBJECT_COLUMNS` of a target's mission or project, or its own.

    The select contains `project`, and `mission`, if the target has one, for conditions on rights.
    """
    nowhere = sa.null().cast(sa.Uuid)
    if target.kind in _OUTSIDE:
        table = _OUTSIDE[target.kind]
        columns = _columns(target.kind.removesuffix("_id"), table)
        stmt = sa.select(*columns, nowhere.label("project_id"), nowhere.label("mission_id"))
        return stmt.where(table.c.id == target.id)
    if target.kind == "project_id":
        location_columns = project.c.id.label("project_id"), nowhere.label("mission_id")
        return sa.select(*_columns("project", project), *location_columns).where(project.c.id == target.id)
    columns = *_columns("mission", mission), mission.c.project_id, mission.c.id.label("mission_id")
    stmt = sa.select(*columns).join(project, project.c.id == mission.c.project_id)
    if target.kind == "mission_id":
        return stmt.where(mission.c.id == target.id)
    inside = _INSIDE[target.kind]
    return stmt.join(inside, inside.c.mission_id == mission.c.id).where(inside.c.id == target.id)


def _columns(resource_type: str, table: sa.Table) -> tuple[sa.ColumnElement[Any], ...]:
    return (
        sa.literal(resource_type).label("resource_type"),
        table.c.id.label("resource_id"),
        table.c.name.label("resource_name"),
    )


class Refusals:
    """The numbers of refusals in the current minute: for each known actor, and for all guests together."""

    def __init__(self) -> None:
        self._started_at = float("-inf")
        self._counts: Counter[uuid.UUID | None] = Counter()
        self._left_out = 0
        self._summary: asyncio.Task[None] | None = None

    def admits(self, actor_id: uuid.UUID | None, now: float) -> bool:
        """Count a refusal of a known actor, or with None of a guest, and return whether it may be audited."""
        if now - self._started_at >= MINUTE_S:
            self._started_at = now
            self._counts.clear()
        self._counts[actor_id] += 1
        return self._counts[actor_id] <= PER_MINUTE

    async def audit(self, database: Database, actor: Actor, event: Event, target: RequestTarget | None) -> None:
        """Audit a refusal, for the owners of the target to see; if that fails, the response stays the same."""
        now = time.monotonic()
        if self.admits(actor.person_id or actor.share_id, now):
            try:
                async with database.begin() as db:
                    row = None if target is None else (await db.execute(_target_object(target))).one_or_none()
                    if row is not None:
                        event = replace(event, project_id=row.project_id, mission_id=row.mission_id)
                    await audit(db, actor, event)
            except DatabaseUnavailable:
                _log.warning("refusal not audited", extra={"fields": {"request_id": actor.request_id}})
            return
        self._left_out += 1
        if self._summary is None:
            self._summary = asyncio.create_task(self._write_summary(database, self._started_at + MINUTE_S - now))

    async def _write_summary(self, database: Database, after_s: float) -> None:
        await asyncio.sleep(after_s)
        count, self._left_out, self._summary = self._left_out, 0, None
        after: Metadata = {"left_out": count, "within_s": MINUTE_S}
        try:
            async with database.begin() as db:
                await audit(db, STRANGER, Event("auth.refused", "request", None, "left out", after=after))
        except DatabaseUnavailable:
            _log.warning("refusals not summed up", extra={"fields": {"left_out": count}})


class AdminReads:
    """The reads by admins that a process checked within the last minute."""

    def __init__(self) -> None:
        self._checked_at: dict[tuple[uuid.UUID | None, RequestTarget | str, int], float] = {}

    async def audit(self, database: Database, admin: Actor, target: RequestTarget | None) -> None:
        """Audit that an admin is about to see something that their own rights would not show.

        Raises DatabaseUnavailable if it cannot be audited, so that it is not shown either.
        """
        operation = admin.operation or ""
        if not is_admin_read(operation):
            return
        level, now = (OPERATIONS[operation].right or Right.read).level, time.monotonic()
        key = (admin.person_id, target or operation, level)
        if now - self._checked_at.get(key, float("-inf")) < _CACHED_S:
            return
        if len(self._checked_at) >= _MAX_CACHED:
            self._checked_at.clear()
        self._checked_at[key] = now
        async with database.begin() as db:
            await db.execute(_insert_unless_audited(admin, _foreign_object(admin, operation, target, level)))


def is_admin_read(operation: str) -> bool:
    """Whether a read operation shows more to admins than to others."""
    permission = OPERATIONS[operation]
    return (permission.on is not ResourceKind.none or operation in _ON_PEOPLE) and operation not in _BY_LINK


def _foreign_object(admin: Actor, operation: str, target: RequestTarget | None, level: int) -> sa.Select[Any]:
    """Return the object that an admin is about to see by admin rights; no row if their own rights suffice."""
    without_admin = admin.without_admin()
    # A limited token shows nothing of the server as a whole.
    is_unlimited = sa.literal(admin.limits is None)
    nowhere = sa.null().cast(sa.Uuid)
    everything = sa.select(
        sa.literal("server").label("resource_type"),
        nowhere.label("resource_id"),
        sa.literal(operation).label("resource_name"),
        nowhere.label("project_id"),
        nowhere.label("mission_id"),
    )
    if OPERATIONS[operation].on is ResourceKind.server or (target is None and operation in _ON_PEOPLE):
        return everything.where(is_unlimited)
    if target is None:
        projects = _inside_limits(admin, sa.select(project.c.id)).where(level_on_project(without_admin) < level)
        return everything.where(sa.exists(projects))
    target_row = _target_object(target)
    if target.kind == "person_id":
        return target_row.where(is_unlimited, sa.literal(target.id != admin.person_id))
    if target.kind == "group_id":
        is_member = (membership.c.group_id == target.id) & (membership.c.person_id == admin.person_id)
        return target_row.where(is_unlimited, ~sa.exists().where(is_member))
    if target.kind == "project_id":
        return _inside_limits(admin, target_row).where(level_on_project(without_admin) < level)
    return _inside_limits(admin, target_row, mission.c.id).where(level_on_mission(without_admin) < level)


def _inside_limits(
    admin: Actor, stmt: sa.Select[Any], mission_id: sa.ColumnElement[Any] | None = None
) -> sa.Select[Any]:
    if admin.limits is None:
        return stmt
    in_project = among(project.c.id, admin.limits.project_ids)
    return stmt.where(in_project if mission_id is None else in_project | among(mission_id, admin.limits.mission_ids))


def _insert_unless_audited(admin: Actor, stmt: sa.Select[Any]) -> sa.Insert:
    seen = stmt.subquery("seen")
    recent = sa.exists().where(
        audit_event.c.actor_id == admin.person_id,
        audit_event.c.operation == _ADMIN_READ,
        audit_event.c.at > sa.func.now() - _READ_INTERVAL,
        audit_event.c.resource_type == seen.c.resource_type,
        audit_event.c.resource_id.is_not_distinct_from(seen.c.resource_id),
        (audit_event.c.resource_type != "server") | (audit_event.c.resource_name == seen.c.resource_name),
    )
    values: dict[str, sa.ColumnElement[Any]] = {
        "operation": sa.literal(_ADMIN_READ),
        "as_admin": sa.true(),
        "actor_id": sa.literal(admin.person_id, sa.Uuid),
        "token_id": sa.literal(admin.token_id, sa.Uuid),
        "session_id": sa.literal(admin.session_id, sa.Uuid),
        "address": sa.literal(admin.address, sa.Text),
        "request_id": sa.literal(admin.request_id, sa.Text),
        "after": sa.cast(sa.func.jsonb_build_object("operation", sa.cast(sa.literal(admin.operation), sa.Text)), JSONB),
    }
    row = sa.select(*(seen.c[name] for name in _OBJECT_COLUMNS), *values.values()).where(~recent)
    return sa.insert(audit_event).from_select([*_OBJECT_COLUMNS, *values], row)
