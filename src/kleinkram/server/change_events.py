"""Publish changes inside the transaction that makes them; PostgreSQL delivers them (NOTIFY) once it commits.

One statement for any number of changes. An event names what changed and where, never its content: `events` decides who
may receive it.
"""

import itertools
import json
import uuid
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace

from sqlalchemy import text

from kleinkram.contract.audit import ChangeKind
from kleinkram.server.db import Connection

CHANNEL = "kleinkram_changes"
EVERYTHING = "*"
"""Published instead of more than `_MAX_EVENTS` events: subscribers must reload everything."""
_MAX_EVENTS = 100
_NOTIFY = text("SELECT pg_notify(:channel, payload) FROM unnest(CAST(:payloads AS text[])) AS payload")


@dataclass(frozen=True)
class ChangeEvent:
    """One change. Without an id, it concerns several objects of the type. `by_id` is the person who made the change."""

    resource_type: str
    change: ChangeKind
    id: uuid.UUID | None = None
    project_id: uuid.UUID | None = None
    mission_id: uuid.UUID | None = None
    by_id: uuid.UUID | None = None

    def payload(self) -> str:
        """Return what `read_event` reads."""
        ids = (self.id, self.project_id, self.mission_id, self.by_id)
        return json.dumps([self.resource_type, self.change.value, *(value and str(value) for value in ids)])


async def publish(db: Connection, events: Iterable[ChangeEvent]) -> None:
    """Publish events as part of the caller's transaction; those of one type and mission become one event."""
    payloads = [event.payload() for event in merge_events(events, max_alike=1)]
    if payloads:
        payloads = payloads if len(payloads) <= _MAX_EVENTS else [EVERYTHING]
        await db.execute(_NOTIFY, {"channel": CHANNEL, "payloads": payloads})


def merge_events(events: Iterable[ChangeEvent], *, max_alike: int) -> list[ChangeEvent]:
    """Return events in order; more than `max_alike` that differ only by id become one event without an id."""
    alike: dict[ChangeEvent, list[ChangeEvent]] = defaultdict(list)
    for event in dict.fromkeys(events):
        alike[replace(event, id=None)].append(event)
    groups = (group if len(group) <= max_alike and merged not in group else [merged] for merged, group in alike.items())
    return list(itertools.chain.from_iterable(groups))


def read_event(payload: str) -> ChangeEvent:
    """Return the event that a payload holds."""
    resource_type, change, *ids = json.loads(payload)
    return ChangeEvent(resource_type, ChangeKind(change), *(uuid.UUID(value) if value else None for value in ids))
