"""Selects of mission events. Functions do not execute them."""

import uuid
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Row,
    Select,
    Text,
    Update,
    and_,
    any_,
    false,
    func,
    literal,
    or_,
    select,
    true,
    type_coerce,
    update,
)
from sqlalchemy.dialects.postgresql import ARRAY

from kleinkram.contract.mission_events import MissionEventFilter, MissionEventRead, MissionEventSort
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.visible import is_visible_mission, sees_whole_missions
from kleinkram.server.db import ArrayText, among, matches_key
from kleinkram.server.filters.dates import nanoseconds
from kleinkram.server.pagination import Order
from kleinkram.server.tables import file, mission, mission_event, person, project, recording, run, run_finding

ORDERS = {
    MissionEventSort.start: Order([mission_event.c.start_ns, mission_event.c.id]),
    MissionEventSort.start_desc: Order([mission_event.c.start_ns, mission_event.c.id], descending=True),
    MissionEventSort.created: Order([mission_event.c.created_at, mission_event.c.id]),
    MissionEventSort.created_desc: Order([mission_event.c.created_at, mission_event.c.id], descending=True),
}


def all_events() -> Select[Any]:
    """Return events as `to_event` reads them, joined with missions and projects, without conditions on rights."""
    # A file in the trash, or in another mission by now, is not shown.
    is_shown_file = and_(
        file.c.id == mission_event.c.file_id,
        file.c.mission_id == mission_event.c.mission_id,
        file.c.deleted_at.is_(None),
    )
    names = (
        mission.c.name.label("mission_name"),
        mission.c.project_id,
        project.c.name.label("project_name"),
        person.c.name.label("created_by_name"),
        file.c.path.label("file_path"),
        recording.c.name.label("recording_name"),
    )
    return (
        select(mission_event, *names)
        .join(mission, mission.c.id == mission_event.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(person, person.c.id == mission_event.c.created_by_id)
        .outerjoin(file, is_shown_file)
        .outerjoin(recording, recording.c.id == mission_event.c.recording_id)
    )


def visible_events(actor: Actor) -> Select[Any]:
    """Return the events that `actor` may see: none for links to some files; their own for tokens that do not read."""
    shown: ColumnElement[bool] = true()
    if actor.limits is not None and actor.limits.file_ids is not None:
        shown = false()
    elif not sees_whole_missions(actor):
        shown = mission_event.c.created_by_id == actor.person_id
    return all_events().where(is_visible_mission(actor), shown)


def filter_events(stmt: Select[Any], matching: MissionEventFilter) -> Select[Any]:
    """Return the events of a select that match."""
    conditions = _of_missions(matching)
    if matching.name:
        conditions.append(or_(*(matches_key(mission_event.c.name_key, glob) for glob in matching.name)))
    if matching.label:
        has_label: ColumnElement[bool] = type_coerce(mission_event.c.labels, ARRAY(Text)).overlap([*matching.label])
        conditions.append(has_label)
    if matching.run_id is not None:
        conditions.append(mission_event.c.run_id == matching.run_id)
    if matching.after is not None:
        last_ns = func.coalesce(mission_event.c.end_ns, mission_event.c.start_ns)
        conditions.append(last_ns >= nanoseconds(matching.after))
    if matching.before is not None:
        conditions.append(mission_event.c.start_ns <= nanoseconds(matching.before))
    return stmt.where(*conditions)


def of_missions(stmt: Select[Any], mission_ids: str) -> Select[Any]:
    """Return the events of a select that are of some missions, whose ids are as PostgreSQL writes arrays."""
    return stmt.where(mission_event.c.mission_id == any_(literal(mission_ids, ArrayText("UUID"))))


def _of_missions(matching: MissionEventFilter) -> list[ColumnElement[bool]]:
    values = (
        (mission_event.c.mission_id, matching.mission_id, matching.mission_ids),
        (mission.c.project_id, matching.project_id, matching.project_ids),
    )
    conditions = [column == one for column, one, _ in values if one is not None]
    return conditions + [among(column, several) for column, _, several in values if several]


def to_event(row: Row[Any], actor: Actor) -> MissionEventRead:
    """Return the event in a row of `all_events`, as `actor` may see it: guests see no people and no runs."""
    values: dict[str, Any] = dict(row._mapping)
    is_person = actor.kind is ActorKind.person
    project_ref = {"id": row.project_id, "name": row.project_name}
    values["mission"] = {"id": row.mission_id, "name": row.mission_name, "project": project_ref}
    values["file"] = None if row.file_path is None else {"id": row.file_id, "path": row.file_path}
    values["recording"] = None if row.recording_name is None else {"id": row.recording_id, "name": row.recording_name}
    values["created_by"] = {"id": row.created_by_id, "name": row.created_by_name} if is_person else None
    if not is_person:
        values |= {"run_id": None, "finding_id": None}
    return MissionEventRead.model_validate(values)


def count_of_mission(mission_id: uuid.UUID) -> Select[tuple[int]]:
    """Return the number of a mission's events."""
    return select(func.count()).where(mission_event.c.mission_id == mission_id)


def live_file(mission_id: uuid.UUID, file_id: uuid.UUID) -> Select[tuple[uuid.UUID]]:
    """Return the id of a file that is in a mission and not in the trash."""
    is_live = (file.c.id == file_id, file.c.mission_id == mission_id, file.c.deleted_at.is_(None))
    return select(file.c.id).where(*is_live)


def recording_of(mission_id: uuid.UUID, recording_id: uuid.UUID) -> Select[tuple[uuid.UUID]]:
    """Return the id of a recording that is in a mission."""
    return select(recording.c.id).where(recording.c.id == recording_id, recording.c.mission_id == mission_id)


def run_of_finding(mission_id: uuid.UUID, finding_id: int) -> Select[tuple[uuid.UUID]]:
    """Return the run of a mission that reported a finding."""
    own = (run_finding.c.id == finding_id, run.c.mission_id == mission_id)
    return select(run.c.id).join(run_finding, run_finding.c.run_id == run.c.id).where(*own)


def change_event(event_id: uuid.UUID, **values: object) -> Update:
    """Return the statement that changes one event."""
    return update(mission_event).where(mission_event.c.id == event_id).values(**values)
