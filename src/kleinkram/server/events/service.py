"""Event streams: the changes that their reader may see, as text/event-stream.

Rights are checked when an event is sent, with the reader's rights at that moment. A stream holds no database
connection while it waits.

Source: HTML Standard, "Server-sent events".
"""

import time
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pydantic import BaseModel

from kleinkram.contract.audit import Change, Refetch, RefetchReason
from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import rights_hash, watchable_missions, watchable_projects
from kleinkram.server.change_events import ChangeEvent, merge_events
from kleinkram.server.db import Connection, Database, among
from kleinkram.server.events.hub import EventSubscription, Hub
from kleinkram.server.tables import mission, project

Reauthenticate = Callable[[Connection], Awaitable[Actor | None]]
"""Finds the actor of a request again; None once their credential is no longer valid."""
KEEP_ALIVE_S = 15.0
# How late the end of rights by expiry is noticed; a revocation is noticed at once.
RIGHTS_CHECK_S = 5.0
_MIN_INTERVAL_S = 0.5
_RETRY_MS = 2000
# More changes of files in one mission than this are sent as one.
_MAX_ALIKE = 20


@dataclass(frozen=True)
class EventStream:
    """The parameters of one stream. It continues after the event with the id `after`."""

    hub: Hub
    database: Database
    authenticate: Reauthenticate
    after: str | None
    for_s: float


class _Output(NamedTuple):
    rights: str | None
    text: str


async def stream_events(stream: EventStream, actor: Actor) -> AsyncIterator[str]:
    """Yield the text of a stream until its time is over, the server stops, or the reader's credential ends."""
    hub = stream.hub
    ends_at = time.monotonic() + stream.for_s
    rights: str | None = None
    with hub.subscribe(actor.person_id, after=stream.after) as subscription:
        opening = f"retry: {_RETRY_MS}\nid: {stream.after or hub.last_event_id}\n\n"
        sent_at = time.monotonic()
        while True:
            checked_at = time.monotonic()
            output = await _take_output(stream, subscription, rights)
            if output is None:
                return
            rights = output.rights
            if opening or output.text or time.monotonic() - sent_at >= KEEP_ALIVE_S:
                yield opening + output.text or ": keep-alive\n\n"
                opening = ""
                sent_at = time.monotonic()
            if time.monotonic() >= ends_at or hub.is_closed:
                return
            await subscription.wait(min(RIGHTS_CHECK_S, ends_at - time.monotonic()))
            await hub.sleep(min(checked_at + _MIN_INTERVAL_S, ends_at) - time.monotonic())


async def _take_output(stream: EventStream, subscription: EventSubscription, rights: str | None) -> _Output | None:
    """Return what to send, by the current rights; None if the credential is no longer valid."""
    async with stream.hub.rights_checks:
        pending = subscription.take(stream.hub.last_event_id)
        try:
            async with stream.database.begin() as db:
                actor = await stream.authenticate(db)
                if actor is None:
                    return None
                current_rights = f"{actor.is_admin} {(await db.execute(rights_hash(actor))).scalar_one()}"
                changes = await _visible_changes(db, actor, pending.events)
        except DatabaseUnavailable:  # rights cannot be checked, so nothing is sent
            subscription.mark_missed()
            await stream.hub.sleep(_MIN_INTERVAL_S)
            return _Output(rights, "")
    reason = RefetchReason.behind if pending.has_overflowed else None
    reason = RefetchReason.missed if pending.was_missed else reason
    if rights not in (None, current_rights):
        reason = RefetchReason.rights
    messages: list[BaseModel] = [*([Refetch(reason=reason)] if reason else []), *changes]
    text = "".join(
        f"event: {type(message).__name__.lower()}\ndata: {message.model_dump_json()}\n\n" for message in messages
    )
    return _Output(current_rights, f"{text}id: {pending.last_event_id}\n\n" if text else "")


async def _visible_changes(db: Connection, actor: Actor, events: Sequence[ChangeEvent]) -> list[Change]:
    """Return the events in missions and projects that the actor sees.

    Changes outside of projects, such as of groups and sessions, are visible to admins and to the person who made them.
    """
    missions: dict[uuid.UUID, uuid.UUID] = {}
    projects: set[uuid.UUID] = set()
    if mission_ids := {event.mission_id for event in events if event.mission_id}:
        columns = (mission.c.id, mission.c.project_id)
        stmt = watchable_missions(actor).with_only_columns(*columns, maintain_column_froms=True)
        missions = {row.id: row.project_id for row in await db.execute(stmt.where(among(mission.c.id, mission_ids)))}
    if project_ids := {event.project_id for event in events if event.project_id}:
        stmt = watchable_projects(actor).with_only_columns(project.c.id)
        projects = set((await db.execute(stmt.where(among(project.c.id, project_ids)))).scalars())
    changes = []
    for event in merge_events(events, max_alike=_MAX_ALIKE):
        is_visible = event.mission_id in missions or event.project_id in projects
        if event.project_id is None and event.mission_id is None and actor.limits is None:
            is_visible = actor.is_admin or (event.by_id is not None and event.by_id == actor.person_id)
        if is_visible:
            project_id = event.project_id or (missions.get(event.mission_id) if event.mission_id else None)
            change = Change(
                resource_type=event.resource_type,
                change=event.change,
                id=event.id,
                project_id=project_id,
                mission_id=event.mission_id,
            )
            changes.append(change)
    return list(dict.fromkeys(changes))
