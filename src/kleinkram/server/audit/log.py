"""Writing to the audit log: events are added in the transaction of the change that they describe."""

import uuid
from dataclasses import dataclass, field
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import aggregate_order_by

from kleinkram.contract.access import Right
from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from kleinkram.server.access.visible import level_on_mission, level_on_project
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, insert_rows, unnest_rows
from kleinkram.server.tables import audit_event, mission, project

# Above the level of every right: only admins may.
_ADMIN_LEVEL = Right.delete.level + 1
# How the verbs of operations change an object; the verbs of no set change it otherwise.
_CREATED = frozenset({"create", "upload", "link", "move_in", "register", "restore", "bootstrap"})
_REMOVED = frozenset({"delete", "revoke", "move_out", "abort", "purge"})
_UNCHANGED = frozenset(
    {"download", "export", "verify", "preview", "denied", "refused", "limited", "approve", "reset_link", "send"}
    # Of a mission or project, and with change events of their own.
    | {"create_event", "update_event", "delete_event", "create_layout", "update_layout", "delete_layout"}
)


@dataclass(frozen=True)
class Event:
    """An entry of the audit log: `operation` is `<resource_type>.<verb>`; `before` and `after`: changed fields.

    `takes` is the operation of `access/operations.py` whose right was required, if not the request's own.
    `needs_admin`: only an admin could do it, if that does not depend on a right on a project or mission.
    """

    operation: str
    resource_type: str
    resource_id: uuid.UUID | None
    resource_name: str
    project_id: uuid.UUID | None = None
    before: Metadata = field(default_factory=dict)
    after: Metadata = field(default_factory=dict)
    mission_id: uuid.UUID | None = None
    takes: str | None = None
    needs_admin: bool = False


class _EventLocation(NamedTuple):
    """Where something happened, and the level of right that it required there."""

    project_id: uuid.UUID | None
    mission_id: uuid.UUID | None
    needed: int


async def audit(db: Connection, actor: Actor | None, *events: Event) -> None:
    """Add events to the audit log, and publish the changes once the caller's transaction commits.

    `actor` is None for jobs of the server; for unknown requesters, pass `STRANGER.for_request(...)`. Events of admins
    are marked where their own rights, at the time of this call, would not have sufficed.
    """
    if not events:
        return
    rows = [_to_row(actor, event) for event in events]
    if actor is None or not actor.is_admin:
        await db.execute(insert_rows(audit_event, rows))
    else:
        locations = [
            _EventLocation(event.project_id, event.mission_id, _needed_level(actor, event)) for event in events
        ]
        numbers = {location: number for number, location in enumerate(dict.fromkeys(locations), start=1)}
        numbered = [{**row, "location": numbers[location]} for row, location in zip(rows, locations, strict=True)]
        columns = [audit_event.c[key] for key in rows[0]]
        values = unnest_rows([*columns, sa.column("location", sa.Integer)], numbered)
        marks = _lacks_own_right(actor, [*numbers])
        marked = sa.select(*(values.c[key] for key in rows[0]), marks[values.c.location])
        await db.execute(sa.insert(audit_event).from_select([*rows[0], "as_admin"], marked))
    changes = []
    for event in events:
        verb = event.operation.partition(".")[2]
        if verb not in _UNCHANGED:
            kind = ChangeKind.created if verb in _CREATED else ChangeKind.changed
            kind = ChangeKind.removed if verb in _REMOVED else kind
            by_id = actor.person_id if actor is not None and event.project_id is None else None
            changes.append(
                ChangeEvent(event.resource_type, kind, event.resource_id, event.project_id, event.mission_id, by_id)
            )
    await publish(db, changes)


def _to_row(actor: Actor | None, event: Event) -> dict[str, object]:
    row: dict[str, object] = {name: value for name, value in vars(event).items() if name in audit_event.c}
    if actor is not None:
        row["actor_id"] = actor.person_id
        row |= {name: getattr(actor, name) for name in ("token_id", "session_id", "share_id", "address", "request_id")}
    return row


def _needed_level(actor: Actor, event: Event) -> int:
    operation = event.takes or actor.operation
    permission = None if operation is None else OPERATIONS[operation]
    if event.needs_admin or (permission is not None and permission.on is ResourceKind.server):
        return _ADMIN_LEVEL
    if permission is None:
        return Right.delete.level  # unknown, so no less suffices
    return 0 if permission.right is None else permission.right.level


def _lacks_own_right(admin: Actor, locations: list[_EventLocation]) -> sa.ScalarSelect[list[bool]]:
    """Return, as an array in order, whether `admin` would have been refused at each location without admin rights."""
    own = admin.without_admin()
    columns = [sa.column("number", sa.Integer), sa.column("project_id", sa.Uuid), sa.column("mission_id", sa.Uuid)]
    rows = [{"number": number, **location._asdict()} for number, location in enumerate(locations)]
    location = unnest_rows([*columns, sa.column("needed", sa.Integer)], rows)
    missions = sa.select(level_on_mission(own)).select_from(mission.join(project))
    missions = missions.where(mission.c.id == location.c.mission_id).correlate_except(mission, project)
    projects = sa.select(level_on_project(own)).select_from(project)
    projects = projects.where(project.c.id == location.c.project_id).correlate_except(project)
    level = sa.func.coalesce(missions.scalar_subquery(), projects.scalar_subquery(), sa.literal(0))
    in_order = aggregate_order_by(level < location.c.needed, location.c.number)
    marks = sa.func.array_agg(in_order, type_=sa.ARRAY(sa.Boolean))
    return sa.select(marks).select_from(location).scalar_subquery()
