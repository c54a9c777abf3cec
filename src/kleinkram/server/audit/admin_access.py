"""Reads by admins of what their own rights would not show them: audited once an hour for each object (decision 14).

The entry is written before the response, in a transaction of its own. A process caches for a minute what it has
checked, so that paging through a list costs one check.
"""

import datetime
import time
import uuid
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Insert,
    Select,
    Text,
    Uuid,
    cast,
    exists,
    func,
    insert,
    literal,
    null,
    select,
    true,
)
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.access import Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from kleinkram.server.access.visible import level_on_mission, level_on_project
from kleinkram.server.audit.queries import RequestTarget, target_place
from kleinkram.server.db import Database, among
from kleinkram.server.tables import audit_event, membership, mission, project

ADMIN_READ = "admin.look"
_AUDITED_EVERY = datetime.timedelta(hours=1)
_CACHED_S = 60
_MAX_CACHED = 10_000
_PEOPLE = frozenset({"list_people", "list_groups", "get_person", "get_group", "list_group_members"})
# Shows nothing without a link.
_BY_LINK = frozenset({"get_share"})
_OBJECT_COLUMNS = ("noun", "noun_id", "noun_name", "project_id", "mission_id")
_Key = tuple[uuid.UUID | None, RequestTarget | str, int]


class AdminReads:
    """The reads by admins that a process checked within the last minute."""

    def __init__(self) -> None:
        self._checked_at: dict[_Key, float] = {}

    async def audit(self, database: Database, admin: Actor, target: RequestTarget | None) -> None:
        """Audit that an admin is about to see something that their own rights would not show.

        Raises DatabaseUnavailable if it cannot be audited, so that it is not shown either.
        """
        operation = admin.operation or ""
        if not is_admin_read(operation):
            return
        level = (OPERATIONS[operation].right or Right.read).level
        if self._is_due((admin.person_id, target or operation, level)):
            async with database.begin() as db:
                await db.execute(_insert_unless_audited(admin, _foreign_object(admin, operation, target, level)))

    def _is_due(self, key: _Key) -> bool:
        now = time.monotonic()
        if now - self._checked_at.get(key, float("-inf")) < _CACHED_S:
            return False
        if len(self._checked_at) >= _MAX_CACHED:
            self._checked_at.clear()
        self._checked_at[key] = now
        return True


def is_admin_read(operation: str) -> bool:
    """Whether a read operation shows more to admins than to others."""
    permission = OPERATIONS[operation]
    return (permission.on is not ResourceKind.none or operation in _PEOPLE) and operation not in _BY_LINK


def _foreign_object(admin: Actor, operation: str, target: RequestTarget | None, level: int) -> Select[Any]:
    """Return the object that an admin is about to see by admin rights; no row if their own rights suffice."""
    own = admin.without_power()
    # A limited token shows nothing of the server as a whole.
    is_unlimited = literal(admin.limits is None)
    nowhere = null().cast(Uuid)
    names = literal("server").label("noun"), nowhere.label("noun_id"), literal(operation).label("noun_name")
    everything = select(*names, nowhere.label("project_id"), nowhere.label("mission_id"))
    if OPERATIONS[operation].on is ResourceKind.server or (target is None and operation in _PEOPLE):
        return everything.where(is_unlimited)
    if target is None:
        return everything.where(exists(_within(admin, select(project.c.id)).where(level_on_project(own) < level)))
    place = target_place(target)
    if target.kind == "person_id":
        return place.where(is_unlimited, literal(target.id != admin.person_id))
    if target.kind == "group_id":
        is_member = exists().where(membership.c.group_id == target.id, membership.c.person_id == admin.person_id)
        return place.where(is_unlimited, ~is_member)
    if target.kind == "project_id":
        return _within(admin, place).where(level_on_project(own) < level)
    return _within(admin, place, mission.c.id).where(level_on_mission(own) < level)


def _within(admin: Actor, stmt: Select[Any], mission_id: ColumnElement[Any] | None = None) -> Select[Any]:
    if admin.limits is None:
        return stmt
    in_project = among(project.c.id, admin.limits.project_ids)
    return stmt.where(in_project if mission_id is None else in_project | among(mission_id, admin.limits.mission_ids))


def _insert_unless_audited(admin: Actor, stmt: Select[Any]) -> Insert:
    seen = stmt.subquery("seen")
    recent = exists().where(
        audit_event.c.actor_id == admin.person_id,
        audit_event.c.operation == ADMIN_READ,
        audit_event.c.at > func.now() - _AUDITED_EVERY,
        audit_event.c.noun == seen.c.noun,
        audit_event.c.noun_id.is_not_distinct_from(seen.c.noun_id),
        (audit_event.c.noun != "server") | (audit_event.c.noun_name == seen.c.noun_name),
    )
    values: dict[str, ColumnElement[Any]] = {
        "operation": literal(ADMIN_READ),
        "as_admin": true(),
        "actor_id": literal(admin.person_id, Uuid),
        "token_id": literal(admin.token_id, Uuid),
        "session_id": literal(admin.session_id, Uuid),
        "address": literal(admin.address, Text),
        "request_id": literal(admin.request_id, Text),
        "after": cast(func.jsonb_build_object("operation", cast(literal(admin.operation), Text)), JSONB),
    }
    row = select(*(seen.c[name] for name in _OBJECT_COLUMNS), *values.values()).where(~recent)
    return insert(audit_event).from_select([*_OBJECT_COLUMNS, *values], row)
