"""Writing the record, and reading it."""

import uuid
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, field

from sqlalchemy import Insert, Integer, column, insert, select

from kleinkram.contract.audit import AuditFilter, AuditRead
from kleinkram.contract.events import ChangeKind
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.paging import Page
from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.operations import OPERATIONS, ResourceKind
from kleinkram.server.audit import queries
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, Database, insert_rows, unnest_rows
from kleinkram.server.paging import PageRequest, fetch_page
from kleinkram.server.tables import audit_event

_AT_ONCE = 500
_NO_RIGHT = 0
# More than anybody holds: what only admins may do.
_POWER = Right.delete.level + 1


@dataclass(frozen=True)
class Event:
    """What happened to one thing: `operation` is `<noun>.<verb>`; before and after hold only what changed.

    `takes` is the row of the table of operations whose right it took here, where that is not the request's own.
    `by_power` says that only an admin could do it, where that is no question of a right on project or mission.
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
    """Add events to the record, as part of the caller's transaction; `actor` is None for the server's own jobs.

    Where nobody knows who asked, it is a stranger (`STRANGER.asking(...)`), so that request and address are kept.
    """
    await record_all(db, actor, events)


async def record_all(db: Connection, actor: Actor | None, events: Sequence[Event]) -> None:
    """Add many events to the record, as part of the caller's transaction.

    What an admin did is marked where they could not have done it by their own rights, as these are when it is recorded.
    What changed by it is told to whoever listens, once the transaction is through.
    """
    if not events:
        return
    rows = [_values(actor, event) for event in events]
    if actor is not None and actor.is_admin:
        await db.execute(_insert_marked(actor, rows, [_place(actor, event) for event in events]))
    else:
        await db.execute(insert_rows(audit_event, rows))
    await publish(db, [notice for event in events if (notice := _notice(actor, event)) is not None])


def _insert_marked(admin: Actor, rows: Sequence[Mapping[str, object]], places: Sequence[queries.Place]) -> Insert:
    """Return what inserts rows with the mark of what took an admin's power, each by where it happened."""
    numbers = {place: number for number, place in enumerate(dict.fromkeys(places), start=1)}
    numbered = [{**row, "place": numbers[place]} for row, place in zip(rows, places, strict=True)]
    said = unnest_rows([*(audit_event.c[key] for key in rows[0]), column("place", Integer)], numbered)
    marks = queries.lacks_own_right(admin, [*numbers])
    values = select(*(said.c[key] for key in rows[0]), marks[said.c.place])
    return insert(audit_event).from_select([*rows[0], "as_admin"], values)


_CREATED = frozenset({"create", "give", "upload", "link", "arrive", "restore", "bootstrap", "put_back"})
_REMOVED = frozenset({"delete", "revoke", "leave", "abort", "purge"})
# What is only asked for, looked at or refused leaves all as it was.
_NO_CHANGE = frozenset({"download", "verify", "look", "denied", "refused", "limited", "approve", "reset_link"})


def _notice(actor: Actor | None, event: Event) -> ChangeEvent | None:
    verb = event.operation.partition(".")[2]
    if verb in _NO_CHANGE:
        return None
    kind = ChangeKind.created if verb in _CREATED else ChangeKind.removed if verb in _REMOVED else ChangeKind.changed
    by_id = actor.person_id if actor is not None and event.project_id is None else None
    return ChangeEvent(event.noun, kind, event.noun_id, event.project_id, event.mission_id, by_id)


def _values(actor: Actor | None, event: Event) -> dict[str, object]:
    values: dict[str, object] = {name: value for name, value in vars(event).items() if name in audit_event.c}
    if actor is None:
        return values
    who: dict[str, object] = {
        "actor_id": actor.person_id,
        "token_id": actor.token_id,
        "session_id": actor.session_id,
        "share_id": actor.share_id,
        "address": actor.address,
        "request_id": actor.request_id,
    }
    return values | who


def _place(actor: Actor, event: Event) -> queries.Place:
    return queries.Place(event.project_id, event.mission_id, _needed(actor, event))


def _needed(actor: Actor, event: Event) -> int:
    """Return the level that an event took on its place."""
    operation = event.takes or actor.operation
    need = None if operation is None else OPERATIONS[operation]
    if event.by_power or (need is not None and need.on is ResourceKind.server):
        return _POWER
    if need is None:
        return Right.delete.level  # nobody said what it took: no less is enough
    return _NO_RIGHT if need.right is None else need.right.level


async def list_events(db: Connection, actor: Actor, *, matching: AuditFilter, page: PageRequest) -> Page[AuditRead]:
    """Return a page of the events that match, latest first.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    rows = await fetch_page(db, queries.matching_events(actor, matching), queries.AUDIT_ORDER, page)
    return Page(items=[queries.to_event(row, actor) for row in rows.items], next=rows.next, total=rows.total)


async def export_events(database: Database, actor: Actor, *, matching: AuditFilter) -> AsyncIterator[AuditRead]:
    """Yield the events that match, oldest first, `_AT_ONCE` in memory.

    Each portion is read in a transaction of its own, so that a slow reader holds no connection. What is recorded
    meanwhile may or may not be among them.
    """
    last = 0
    while True:
        async with database.begin() as db:
            statement = queries.events_after(actor, matching, event_id=last, limit=_AT_ONCE)
            rows = (await db.execute(statement)).all()
        for row in rows:
            yield queries.to_event(row, actor)
        if len(rows) < _AT_ONCE:
            return
        last = rows[-1].id
