"""Looking by an admin at what is nobody's concern of theirs: noted once an hour for each thing (decision 14).

A note is made before the answer leaves, in a transaction of its own. A process remembers for a minute what it has
asked the database about, so that an admin who pages through a list is looked up once.
"""

import datetime
import time
import uuid
from collections.abc import Mapping
from typing import Any

from sqlalchemy import ColumnElement, Select, Text, Uuid, cast, exists, func, insert, literal, null, select, true
from sqlalchemy.dialects.postgresql import JSONB

from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from kleinkram.server.access.visible import level_on_mission, level_on_project
from kleinkram.server.audit.places import Named, whereabouts
from kleinkram.server.db import Database, among
from kleinkram.server.tables import audit_event, membership, mission, project

LOOK = "admin.look"
_NOTED_EVERY = datetime.timedelta(hours=1)
_ASKED_EVERY_S = 60
_REMEMBERED = 10_000
_PEOPLE = frozenset({"list_people", "list_groups", "get_person", "get_group", "list_group_members"})
# What shows nothing to whoever came without a link.
_BY_LINK = frozenset({"get_share"})
_WHERE = ("noun", "noun_id", "noun_name", "project_id", "mission_id")
_Key = tuple[uuid.UUID | None, Named | str, int]


class Looks:
    """What a process has asked about in the minute that runs."""

    def __init__(self) -> None:
        self._asked: dict[_Key, float] = {}

    async def note(self, database: Database, admin: Actor, of: Named | None) -> None:
        """Note that an admin is about to see what by their own rights they could not; nothing for what they could.

        Raises:
            DatabaseUnavailable: it could not be noted; so it is not shown either.
        """
        operation = admin.operation or ""
        if not is_a_look(operation):
            return
        level = (OPERATIONS[operation].right or Right.read).level
        if self._is_due((admin.person_id, of or operation, level)):
            async with database.begin() as db:
                await db.execute(_unless_noted(admin, _foreign(admin, operation, of, level)))

    def _is_due(self, key: _Key) -> bool:
        now = time.monotonic()
        if now - self._asked.get(key, float("-inf")) < _ASKED_EVERY_S:
            return False
        if len(self._asked) >= _REMEMBERED:
            self._asked.clear()
        self._asked[key] = now
        return True


def is_a_look(operation: str) -> bool:
    """Say whether an operation that is read shows more to an admin than to others."""
    need = OPERATIONS[operation]
    return (need.on is not ResourceKind.nothing or operation in _PEOPLE) and operation not in _BY_LINK


def _foreign(admin: Actor, operation: str, of: Named | None, level: int) -> Select[Any]:
    """Return what an admin is about to see by their power, as the record names it; no row where it takes none."""
    own = admin.without_power()
    # A token that is limited to some places sees nothing of the server as a whole.
    is_whole = literal(admin.limits is None)
    if OPERATIONS[operation].on is ResourceKind.server or (of is None and operation in _PEOPLE):
        return _everything(operation).where(is_whole)
    if of is None:
        return _everything(operation).where(
            exists(_within(admin, select(project.c.id)).where(level_on_project(own) < level))
        )
    found = whereabouts(of)
    if of.kind == "person_id":
        return found.where(is_whole, literal(of.id != admin.person_id))
    if of.kind == "group_id":
        return found.where(is_whole, ~_is_in(admin, of.id))
    if of.kind == "project_id":
        return _within(admin, found).where(level_on_project(own) < level)
    return _within(admin, found, mission.c.id).where(level_on_mission(own) < level)


def _within(admin: Actor, stmt: Select[Any], mission_id: ColumnElement[Any] | None = None) -> Select[Any]:
    if admin.limits is None:
        return stmt
    of_project = among(project.c.id, admin.limits.project_ids)
    return stmt.where(of_project if mission_id is None else of_project | among(mission_id, admin.limits.mission_ids))


def _everything(operation: str) -> Select[Any]:
    nowhere = null().cast(Uuid)
    return select(
        literal("server").label("noun"),
        nowhere.label("noun_id"),
        literal(operation).label("noun_name"),
        nowhere.label("project_id"),
        nowhere.label("mission_id"),
    )


def _is_in(admin: Actor, group_id: uuid.UUID) -> Any:
    return exists().where(membership.c.group_id == group_id, membership.c.person_id == admin.person_id)


def _unless_noted(admin: Actor, seen: Select[Any]) -> Any:
    thing = seen.subquery("seen")
    recently = exists().where(
        audit_event.c.actor_id == admin.person_id,
        audit_event.c.operation == LOOK,
        audit_event.c.at > func.now() - _NOTED_EVERY,
        audit_event.c.noun == thing.c.noun,
        audit_event.c.noun_id.is_not_distinct_from(thing.c.noun_id),
        (audit_event.c.noun != "server") | (audit_event.c.noun_name == thing.c.noun_name),
    )
    who: Mapping[str, Any] = {
        "operation": literal(LOOK),
        "as_admin": true(),
        "actor_id": literal(admin.person_id, Uuid),
        "token_id": literal(admin.token_id, Uuid),
        "session_id": literal(admin.session_id, Uuid),
        "address": literal(admin.address, Text),
        "request_id": literal(admin.request_id, Text),
        "after": cast(func.jsonb_build_object("operation", cast(literal(admin.operation), Text)), JSONB),
    }
    row = select(*(thing.c[name] for name in _WHERE), *who.values()).where(~recently)
    return insert(audit_event).from_select([*_WHERE, *who], row)
