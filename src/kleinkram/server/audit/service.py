"""Writing and reading the audit log."""

import uuid
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field

from sqlalchemy import Integer, column, insert, select

from kleinkram.contract.access import Right
from kleinkram.contract.audit import AuditFilter, AuditRead, ChangeKind
from kleinkram.contract.base import Page
from kleinkram.contract.metadata import Metadata
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from kleinkram.server.audit.queries import AUDIT_ORDER, EventPlace, lacks_own_right, matching_events, to_event
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, Database, insert_rows, unnest_rows
from kleinkram.server.pagination import PageRequest, read_page
from kleinkram.server.tables import audit_event

_EXPORT_BATCH = 500
# Above every level of a right: only admins may.
_ADMIN_LEVEL = Right.delete.level + 1
# What the verbs of operations change; requests, reads and refusals change nothing, all others change an object.
_CREATED = frozenset({"create", "give", "upload", "link", "arrive", "restore", "bootstrap", "put_back"})
_REMOVED = frozenset({"delete", "revoke", "leave", "abort", "purge"})
_NO_CHANGE = frozenset({"download", "verify", "preview", "denied", "refused", "limited", "approve", "reset_link"})


@dataclass(frozen=True)
class Event:
    """A change of an object: `operation` is `<noun>.<verb>`; `before` and `after` contain only changed fields.

    `takes` is the operation of `access/operations.py` whose right was required, if not the request's own.
    `by_power`: only an admin could do it, if that does not depend on a right on a project or mission.
    """

    operation: str
    noun: str
    noun_id: uuid.UUID | None
    noun_name: str
    project_id: uuid.UUID | None
    before: Metadata = field(default_factory=dict)
    after: Metadata = field(default_factory=dict)
    mission_id: uuid.UUID | None = None
    takes: str | None = None
    by_power: bool = False


async def record(db: Connection, actor: Actor | None, *events: Event) -> None:
    """Add events to the audit log in the caller's transaction; `actor` is None for jobs of the server.

    For unknown requesters, pass `STRANGER.asking(...)`, which keeps the request id and the address.
    """
    await record_all(db, actor, events)


async def record_all(db: Connection, actor: Actor | None, events: Sequence[Event]) -> None:
    """Add many events to the audit log, and publish the changes once the transaction commits.

    Events of admins are marked where their own rights, at the time of this call, would not have sufficed.
    """
    if not events:
        return
    rows = [_to_row(actor, event) for event in events]
    if actor is None or not actor.is_admin:
        await db.execute(insert_rows(audit_event, rows))
    else:
        places = [EventPlace(event.project_id, event.mission_id, _needed_level(actor, event)) for event in events]
        numbers = {place: number for number, place in enumerate(dict.fromkeys(places), start=1)}
        numbered = [{**row, "place": numbers[place]} for row, place in zip(rows, places, strict=True)]
        values = unnest_rows([*(audit_event.c[key] for key in rows[0]), column("place", Integer)], numbered)
        marks = lacks_own_right(actor, [*numbers])
        marked = select(*(values.c[key] for key in rows[0]), marks[values.c.place])
        await db.execute(insert(audit_event).from_select([*rows[0], "as_admin"], marked))
    changes = []
    for event in events:
        verb = event.operation.partition(".")[2]
        if verb not in _NO_CHANGE:
            kind = ChangeKind.created if verb in _CREATED else ChangeKind.changed
            kind = ChangeKind.removed if verb in _REMOVED else kind
            by_id = actor.person_id if actor is not None and event.project_id is None else None
            changes.append(ChangeEvent(event.noun, kind, event.noun_id, event.project_id, event.mission_id, by_id))
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
    if event.by_power or (permission is not None and permission.on is ResourceKind.server):
        return _ADMIN_LEVEL
    if permission is None:
        return Right.delete.level  # unknown, so no less suffices
    return 0 if permission.right is None else permission.right.level


async def list_events(db: Connection, actor: Actor, *, matching: AuditFilter, page: PageRequest) -> Page[AuditRead]:
    """Return a page of the events that match, latest first. Raises InvalidCursor."""
    return await read_page(db, matching_events(actor, matching), AUDIT_ORDER, page, lambda row: to_event(row, actor))


async def export_events(database: Database, actor: Actor, *, matching: AuditFilter) -> AsyncIterator[AuditRead]:
    """Yield the events that match, oldest first, with at most `_EXPORT_BATCH` in memory.

    Each batch has its own transaction, so that a slow reader holds no connection. Events that are recorded meanwhile
    may or may not be included.
    """
    last_id = 0
    while True:
        stmt = matching_events(actor, matching).where(audit_event.c.id > last_id)
        async with database.begin() as db:
            rows = (await db.execute(stmt.order_by(audit_event.c.id).limit(_EXPORT_BATCH))).all()
        for row in rows:
            yield to_event(row, actor)
        if len(rows) < _EXPORT_BATCH:
            return
        last_id = rows[-1].id
