"""Operations on mission events: people may change and delete their own, and with more rights on the mission all."""

import uuid
from typing import Any

from sqlalchemy import delete, insert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, InvalidRequest, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.mission_events import (
    MAX_MISSION_EVENTS,
    EventReference,
    MissionEventCreate,
    MissionEventFilter,
    MissionEventRead,
    MissionEventSort,
    MissionEventUpdate,
)
from kleinkram.contract.names import name_key
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_match, require_mission
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.filters.plan import find_visible_mission_ids
from kleinkram.server.mission_events import queries
from kleinkram.server.missions.service import lock_mission
from kleinkram.server.pagination import PageRequest, read_page
from kleinkram.server.tables import mission_event

# Fields of events that are columns of the same name.
_PLAIN = ("start_ns", "end_ns", "labels", "colour", "note", "topic")
_REQUIRED = ("name", "start_ns", "labels", "note")
_UNIQUE = {"pk_mission_event": "id", "uq_mission_event_finding_id": "finding_id"}
# The change event, and the operation with its permission, of each entry of the audit log.
_CHANGES = {
    "mission.create_event": (ChangeKind.created, "create_mission_event"),
    "mission.update_event": (ChangeKind.changed, "update_mission_event"),
    "mission.delete_event": (ChangeKind.removed, "delete_mission_event"),
}


async def list_events(
    db: Connection, actor: Actor, *, matching: MissionEventFilter, sort: MissionEventSort, page: PageRequest
) -> Page[MissionEventRead]:
    """Return a page of the visible events that match. Raises InvalidCursor."""
    stmt = queries.filter_events(queries.visible_events(actor), matching)
    if matching.mission_id is None and not matching.mission_ids:
        # Missions have few events: those of all visible ones are sorted, instead of passing those of everybody.
        visible_ids = await find_visible_mission_ids(db, actor)
        stmt = stmt if visible_ids is None else queries.of_missions(stmt, visible_ids)
    return await read_page(db, stmt, queries.ORDERS[sort], page, lambda row: queries.to_event(row, actor))


async def get_event(db: Connection, actor: Actor, event_id: uuid.UUID) -> MissionEventRead:
    """Return one event. Raises NotFound."""
    stmt = queries.visible_events(actor).where(mission_event.c.id == event_id)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(resource_type="event", ref=str(event_id))
    return queries.to_event(row, actor)


async def create_event(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID, new_event: MissionEventCreate
) -> MissionEventRead:
    """Add an event to a mission and return it; an event of this id or finding that the mission has is returned.

    Raises:
        NotFound: the mission does not exist, or is not visible.
        Forbidden: the actor may not add events to it.
        InvalidRequest: it ends before it starts, refers to something that the mission does not have, or the mission
            has very many events.
    """
    await lock_mission(db, mission_id)
    await require_mission(db, actor, "create_mission_event", mission_id)
    existing = await _find_existing(db, actor, mission_id, new_event)
    if existing is not None:
        return existing
    _check_span(new_event.start_ns, new_event.end_ns)
    await _check_references(db, mission_id, file_id=new_event.file_id, recording_id=new_event.recording_id)
    run_id = await _run_of(db, actor, mission_id, new_event.finding_id)
    if (await db.execute(queries.count_of_mission(mission_id))).scalar_one() >= MAX_MISSION_EVENTS:
        raise _invalid("name", f"a mission has at most {MAX_MISSION_EVENTS:,} events")
    event_id = new_event.id or uuid.uuid4()
    values = {name: getattr(new_event, name) for name in _PLAIN}
    values |= _reference(new_event.file_id, new_event.recording_id)
    values |= {"id": event_id, "mission_id": mission_id, "run_id": run_id, "finding_id": new_event.finding_id}
    values |= {"name": new_event.name, "name_key": name_key(new_event.name), "created_by_id": actor.person_id}
    values["labels"] = [*dict.fromkeys(new_event.labels)]
    try:
        await db.execute(insert(mission_event).values(**values))
    except IntegrityError as error:
        if (field := _UNIQUE.get(violated_constraint(error) or "")) is None:
            raise
        raise _invalid(field, "it belongs to an event that you do not see here") from None
    created = await get_event(db, actor, event_id)
    await _record(db, actor, "mission.create_event", created, after=_plain(created))
    return created


async def update_event(
    db: Connection, actor: Actor, *, event_id: uuid.UUID, changes: MissionEventUpdate, if_match: str | None = None
) -> MissionEventRead:
    """Change an event and return it; its ETag is not checked where nothing changes.

    Raises:
        NotFound: it does not exist, or is not visible.
        Forbidden: the actor may not change it.
        InvalidRequest: it would end before it starts, or refers to something that the mission does not have.
        EditConflict: its ETag is not the one in `if_match`.
    """
    old = await _lock(db, actor, event_id, "update_mission_event")
    values = _changed_values(old, changes)
    if not values:
        return old
    require_match(if_match, old.etag, resource_type="event", name=old.name)
    _check_span(int(str(values.get("start_ns", old.start_ns))), values.get("end_ns", old.end_ns))
    await _check_references(db, old.mission.id, file_id=values.get("file_id"), recording_id=values.get("recording_id"))
    await db.execute(queries.change_event(event_id, **values))
    new = await get_event(db, actor, event_id)
    before, after = _plain(old), _plain(new)
    differing = [name for name in before if before[name] != after[name]]
    versions = ({name: version[name] for name in differing} for version in (before, after))
    await _record(db, actor, "mission.update_event", new, *versions)
    return new


async def delete_event(db: Connection, actor: Actor, *, event_id: uuid.UUID) -> None:
    """Delete an event.

    Raises:
        NotFound: it does not exist, or is not visible.
        Forbidden: the actor may not delete it.
    """
    old = await _lock(db, actor, event_id, "delete_mission_event")
    await db.execute(delete(mission_event).where(mission_event.c.id == event_id))
    await _record(db, actor, "mission.delete_event", old, _plain(old))


async def _find_existing(
    db: Connection, actor: Actor, mission_id: uuid.UUID, new_event: MissionEventCreate
) -> MissionEventRead | None:
    """Return the event of a mission that a request would add again."""
    stmt = queries.visible_events(actor).where(mission_event.c.mission_id == mission_id)
    for column, value in ((mission_event.c.id, new_event.id), (mission_event.c.finding_id, new_event.finding_id)):
        row = None if value is None else (await db.execute(stmt.where(column == value))).one_or_none()
        if row is not None:
            return queries.to_event(row, actor)
    return None


async def _lock(db: Connection, actor: Actor, event_id: uuid.UUID, operation: str) -> MissionEventRead:
    """Lock an event's mission, and check that the actor may change the event. Raises NotFound or Forbidden."""
    mission_id = (await get_event(db, actor, event_id)).mission.id
    await lock_mission(db, mission_id)
    current = await get_event(db, actor, event_id)
    await require_mission(db, actor, _required(actor, current, operation), current.mission.id)
    return current


def _required(actor: Actor, event: MissionEventRead, operation: str) -> str:
    """Return the operation whose right is required: that of adding events suffices for one's own.

    A run has its own, and not those of the person who started it.
    """
    is_own = event.created_by is not None and event.created_by.id == actor.person_id
    if actor.run_id is not None:
        is_own = event.run_id == actor.run_id
    return "create_mission_event" if is_own else operation


def _changed_values(old: MissionEventRead, changes: MissionEventUpdate) -> dict[str, Any]:
    """Return the columns that differ after a change."""
    requested = {name: getattr(changes, name) for name in ("name", *_PLAIN) if name in changes.model_fields_set}
    values = {
        name: value
        for name, value in requested.items()
        if value != getattr(old, name) and not (value is None and name in _REQUIRED)
    }
    if "labels" in values:
        values["labels"] = [*dict.fromkeys(values["labels"])]
    if "name" in values:
        values["name_key"] = name_key(values["name"])
    return values | _changed_reference(old, changes)


def _changed_reference(old: MissionEventRead, changes: MissionEventUpdate) -> dict[str, Any]:
    """Return the columns of the reference where a change replaces or removes it, also one to something that is gone."""
    named = changes.file_id is not None or changes.recording_id is not None
    if not named and f"{old.refers_to.value}_id" not in changes.model_fields_set:
        return {}
    present = {"file_id": old.file and old.file.id, "recording_id": old.recording and old.recording.id}
    values = _reference(changes.file_id, changes.recording_id)
    return {} if values == {**present, "refers_to": old.refers_to.value} else values


def _reference(file_id: uuid.UUID | None, recording_id: uuid.UUID | None) -> dict[str, Any]:
    """Return the columns of an event's reference; without one, it is of the whole mission."""
    refers_to = EventReference.mission if file_id is None else EventReference.file
    if recording_id is not None:
        refers_to = EventReference.recording
    return {"file_id": file_id, "recording_id": recording_id, "refers_to": refers_to.value}


def _check_span(start_ns: int, end_ns: int | None) -> None:
    if end_ns is not None and end_ns < start_ns:
        raise _invalid("end_ns", "it is before the start")


async def _check_references(
    db: Connection, mission_id: uuid.UUID, *, file_id: uuid.UUID | None, recording_id: uuid.UUID | None
) -> None:
    if file_id is not None and (await db.execute(queries.live_file(mission_id, file_id))).first() is None:
        raise _invalid("file_id", "the mission has no such file")
    if recording_id is not None and (await db.execute(queries.recording_of(mission_id, recording_id))).first() is None:
        raise _invalid("recording_id", "the mission has no such recording")


async def _run_of(db: Connection, actor: Actor, mission_id: uuid.UUID, finding_id: int | None) -> uuid.UUID | None:
    """Return the run that reported the finding, else the run that adds the event."""
    if finding_id is None:
        return actor.run_id
    run_id: uuid.UUID | None = (await db.execute(queries.run_of_finding(mission_id, finding_id))).scalar_one_or_none()
    if run_id is None:
        raise _invalid("finding_id", "no run of the mission reported such a finding")
    return run_id


def _plain(event: MissionEventRead) -> Metadata:
    """Return the fields of an event for the audit log."""
    return {
        "event": event.name,
        "start_ns": event.start_ns,
        "end_ns": event.end_ns,
        "labels": [*event.labels],
        "colour": event.colour,
        "note": event.note,
        "refers_to": event.refers_to.value,
        "file": None if event.file is None else event.file.path,
        "recording": None if event.recording is None else event.recording.name,
        "topic": event.topic,
    }


async def _record(
    db: Connection,
    actor: Actor,
    operation: str,
    event: MissionEventRead,
    before: Metadata | None = None,
    after: Metadata | None = None,
) -> None:
    """Write a change of an event to the audit log of its mission, and tell open pages of it."""
    mission, (change, permission) = event.mission, _CHANGES[operation]
    entry = Event(
        *(operation, "mission", mission.id, mission.name, mission.project.id, before or {}, after or {}),
        mission_id=mission.id,
        takes=_required(actor, event, permission),
    )
    await audit(db, actor, entry)
    await publish(db, [ChangeEvent("mission_event", change, event.id, mission.project.id, mission.id)])


def _invalid(field: str, message: str) -> InvalidRequest:
    return InvalidRequest(problems=[FieldProblem(field=field, message=message)])
