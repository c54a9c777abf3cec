"""One stream of events: who may know of a change is asked when it is told, of whoever they are by then.

Holds no database connection while it waits. What it says is text/event-stream.

Source: HTML Standard, "Server-sent events".
"""

import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass

from pydantic import BaseModel

from kleinkram.contract.errors import DatabaseUnavailable
from kleinkram.contract.events import Change, Refetch, RefetchReason
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import standing
from kleinkram.server.change_events import ChangeEvent, merge_events
from kleinkram.server.db import Connection, Database
from kleinkram.server.events import queries
from kleinkram.server.events.hub import Heard, Hub, Listener

# Who somebody is, found anew from what they came with; None once that is not good any more.
FindAgain = Callable[[Connection], Awaitable[Actor | None]]
HEARTBEAT_S = 15.0
# How late it is noticed that rights ended by themselves; what somebody ended is noticed at once.
LOOK_S = 5.0
_GAP_S = 0.5
_RETRY_MS = 2000
# Files of one mission told one by one; more are told as "files of it".
_MOST_ALIKE = 20


@dataclass(frozen=True)
class Watch:
    """What a stream is made from: where it hears, who listens, and after which event it goes on."""

    hub: Hub
    database: Database
    find: FindAgain
    after: str | None
    for_s: float


@dataclass(frozen=True)
class _Seen:
    rights: str | None
    said: str


async def watch(asked: Watch, actor: Actor) -> AsyncIterator[str]:
    """Yield pieces of a stream, until it was long enough, the server stops, or whoever listens may not any more."""
    hub = asked.hub
    ends_at = time.monotonic() + asked.for_s
    rights: str | None = None
    with hub.listening(actor.person_id, after=asked.after) as listener:
        opening = f"retry: {_RETRY_MS}\nid: {asked.after or hub.place}\n\n"
        spoke_at = time.monotonic()
        while True:
            looked_at = time.monotonic()
            seen = await _look(asked, listener, rights)
            if seen is None:
                return
            rights = seen.rights
            if opening or seen.said or time.monotonic() - spoke_at >= HEARTBEAT_S:
                yield opening + seen.said or ": still here\n\n"
                opening = ""
                spoke_at = time.monotonic()
            if time.monotonic() >= ends_at or hub.is_over:
                return
            await listener.wait(min(LOOK_S, ends_at - time.monotonic()))
            await hub.rest(min(looked_at + _GAP_S, ends_at) - time.monotonic())


async def _look(asked: Watch, listener: Listener, rights: str | None) -> _Seen | None:
    """Return what is to be said, by the rights of this moment; None where there are none any more."""
    async with asked.hub.looking:
        heard = listener.take(asked.hub.place)
        try:
            async with asked.database.begin() as db:
                actor = await asked.find(db)
                if actor is None:
                    return None
                rights_now = f"{actor.is_admin} {(await db.execute(standing(actor))).scalar_one()}"
                changes = await _known(db, actor, heard.notices)
        except DatabaseUnavailable:  # nothing is told that nobody could say is theirs to know
            listener.miss()
            await asked.hub.rest(_GAP_S)
            return _Seen(rights, "")
    reason = _reason(heard, is_other=rights is not None and rights != rights_now)
    events: list[BaseModel] = [*([Refetch(reason=reason)] if reason else []), *changes]
    said = "".join(f"event: {type(each).__name__.lower()}\ndata: {each.model_dump_json()}\n\n" for each in events)
    return _Seen(rights_now, f"{said}id: {heard.until}\n\n" if said else "")


def _reason(heard: Heard, *, is_other: bool) -> RefetchReason | None:
    if is_other:
        return RefetchReason.rights
    if heard.was_missed:
        return RefetchReason.missed
    return RefetchReason.behind if heard.was_too_much else None


async def _known(db: Connection, actor: Actor, notices: Sequence[ChangeEvent]) -> list[Change]:
    missions = {each.mission_id for each in notices if each.mission_id is not None}
    projects = {each.project_id for each in notices if each.project_id is not None}
    of_mission = {}
    if missions:
        rows = await db.execute(queries.known_missions(actor, missions))
        of_mission = {row.id: row.project_id for row in rows}
    known = set((await db.execute(queries.known_projects(actor, projects))).scalars()) if projects else set()
    told = [
        Change(
            noun=each.noun,
            change=each.change,
            id=each.id,
            project_id=each.project_id or of_mission.get(each.mission_id),
            mission_id=each.mission_id,
        )
        for each in merge_events(notices, max_alike=_MOST_ALIKE)
        if each.mission_id in of_mission or each.project_id in known or _is_own(actor, each)
    ]
    return list(dict.fromkeys(told))


def _is_own(actor: Actor, notice: ChangeEvent) -> bool:
    """Say of something that is in no project, a session or a group, whether somebody did it themselves, or is admin."""
    if notice.project_id is not None or notice.mission_id is not None or actor.limits is not None:
        return False
    return actor.is_admin or (notice.by_id is not None and notice.by_id == actor.person_id)
