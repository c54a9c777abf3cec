"""The term `event:` of searches as SQL: missions that have events of these names, files that were recorded then."""

import uuid
from collections.abc import Sequence

from sqlalchemy import ColumnElement, Select, and_, exists, func, or_, select

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.mission_events import EventReference
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import sees_whole_missions
from kleinkram.server.db import matches_key
from kleinkram.server.tables import blob, file, mission, mission_event

_HIDDEN = "this credential does not show the events of missions"


def has_event(actor: Actor, names: Sequence[str]) -> list[ColumnElement[bool]]:
    """Return the condition that each `mission` has an event of one of these names or globs; none without names.

    Raises:
        InvalidQuery: the actor does not see events.
    """
    for name in [] if sees_whole_missions(actor) else names:
        raise InvalidQuery(expression=name, reason=_HIDDEN)
    return [mission.c.id.in_(_missions_with(names))] if names else []


def recorded_during_event(actor: Actor, names: Sequence[str]) -> list[ColumnElement[bool]]:
    """Return the conditions that each `file`, joined with its `blob`, was recorded during an event, or is its file.

    An event that refers to a file or a recording is of that one, and of none where it is gone; others are of all files
    of the mission at that time.

    Raises:
        InvalidQuery: the actor does not see events.
    """
    if not names:
        return []
    last_ns = func.coalesce(mission_event.c.end_ns, mission_event.c.start_ns)
    is_during = and_(mission_event.c.start_ns <= blob.c.end_ns, last_ns >= file.c.start_ns)
    is_of_file = or_(
        mission_event.c.file_id == file.c.id,
        mission_event.c.recording_id.is_not(None) & (mission_event.c.recording_id == file.c.recording_id) & is_during,
        (mission_event.c.refers_to == EventReference.mission.value) & is_during,
    )
    during = (
        exists()
        .select_from(mission_event)
        .where(mission_event.c.mission_id == file.c.mission_id, is_of_file, _has_name(names))
    )
    # The missions first: an index of names leads to few, and the files of others are not read.
    return [*has_event(actor, names), during.correlate(file, blob)]


def _missions_with(names: Sequence[str]) -> Select[tuple[uuid.UUID]]:
    return select(mission_event.c.mission_id).where(_has_name(names)).correlate(None)


def _has_name(names: Sequence[str]) -> ColumnElement[bool]:
    return or_(*(matches_key(mission_event.c.name_key, name) for name in names))
