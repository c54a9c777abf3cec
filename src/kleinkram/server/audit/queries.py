"""Selects on the audit log, and on the objects that requests name; they touch no connection."""

import datetime
import uuid
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from sqlalchemy import (
    ARRAY,
    Boolean,
    ColumnElement,
    Integer,
    Row,
    ScalarSelect,
    Select,
    Table,
    Uuid,
    column,
    func,
    literal,
    null,
    select,
    union,
)
from sqlalchemy.dialects.postgresql import aggregate_order_by

from kleinkram.contract.access import Right
from kleinkram.contract.audit import AuditFilter, AuditRead, CredentialRef
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import level_on_mission, level_on_project, trashed_projects, visible_projects
from kleinkram.server.db import matches, unnest_rows
from kleinkram.server.pagination import Order
from kleinkram.server.tables import (
    access_group,
    audit_event,
    file,
    mission,
    person,
    project,
    recording,
    share,
    token,
    upload,
)

# Latest first; exports are in the opposite order.
AUDIT_ORDER = Order([audit_event.c.id], descending=True)
# Parameters of requests: of objects in a mission, and of objects outside projects.
_INSIDE = {"file_id": file, "recording_id": recording, "upload_id": upload}
_OUTSIDE = {"person_id": person, "group_id": access_group}
_INVALID_ID = uuid.UUID(int=0)


class RequestTarget(NamedTuple):
    """The object that a request names: the name of the parameter, and the id."""

    kind: str
    id: uuid.UUID


class EventPlace(NamedTuple):
    """Where something happened, and the level of right that it required there."""

    project_id: uuid.UUID | None
    mission_id: uuid.UUID | None
    needed: int


def request_target(path: Mapping[str, object], query: Mapping[str, str]) -> RequestTarget | None:
    """Return the innermost object in a request's path, else in its query; None if the request is about everything."""
    parameters = {name: query[name] for name in ("project_id", "mission_id") if name in query}
    parameters |= {name: str(value) for name, value in path.items()}
    kind = next((name for name in (*_INSIDE, "mission_id", "project_id", *_OUTSIDE) if name in parameters), None)
    if kind is None:
        return None
    try:
        return RequestTarget(kind, uuid.UUID(parameters[kind]))
    except ValueError:
        return RequestTarget(kind, _INVALID_ID)


def target_place(target: RequestTarget) -> Select[Any]:
    """Return `noun`, `noun_id`, `noun_name`, `project_id`, `mission_id` of a target's mission or project, or its own.

    The select contains `project`, and `mission`, if the target has one, for conditions on rights.
    """
    nowhere = null().cast(Uuid)
    if target.kind in _OUTSIDE:
        table = _OUTSIDE[target.kind]
        own = _columns(target.kind.removesuffix("_id"), table)
        return select(*own, nowhere.label("project_id"), nowhere.label("mission_id")).where(table.c.id == target.id)
    if target.kind == "project_id":
        place = project.c.id.label("project_id"), nowhere.label("mission_id")
        return select(*_columns("project", project), *place).where(project.c.id == target.id)
    columns = *_columns("mission", mission), mission.c.project_id, mission.c.id.label("mission_id")
    stmt = select(*columns).join(project, project.c.id == mission.c.project_id)
    if target.kind == "mission_id":
        return stmt.where(mission.c.id == target.id)
    inside = _INSIDE[target.kind]
    return stmt.join(inside, inside.c.mission_id == mission.c.id).where(inside.c.id == target.id)


def _columns(noun: str, table: Table) -> tuple[ColumnElement[Any], ...]:
    return literal(noun).label("noun"), table.c.id.label("noun_id"), table.c.name.label("noun_name")


def lacks_own_right(admin: Actor, places: Sequence[EventPlace]) -> ScalarSelect[Sequence[bool]]:
    """Return, as an array in order, whether `admin` would have been refused at each place without admin rights."""
    own = admin.without_power()
    columns = [column("number", Integer), column("project_id", Uuid), column("mission_id", Uuid)]
    rows = [{"number": number, **place._asdict()} for number, place in enumerate(places)]
    place = unnest_rows([*columns, column("needed", Integer)], rows)
    missions = select(level_on_mission(own)).select_from(mission.join(project))
    missions = missions.where(mission.c.id == place.c.mission_id).correlate_except(mission, project)
    projects = select(level_on_project(own)).select_from(project)
    projects = projects.where(project.c.id == place.c.project_id).correlate_except(project)
    level = func.coalesce(missions.scalar_subquery(), projects.scalar_subquery(), literal(0))
    in_order = aggregate_order_by(level < place.c.needed, place.c.number)
    return select(func.array_agg(in_order, type_=ARRAY(Boolean))).select_from(place).scalar_subquery()


def matching_events(actor: Actor, matching: AuditFilter) -> Select[Any]:
    """Return the events that match and that `actor` may see: those of projects they own; for admins, all."""
    same = {
        audit_event.c.actor_id: matching.person_id,
        audit_event.c.token_id: matching.token_id,
        audit_event.c.share_id: matching.share_id,
        audit_event.c.noun: matching.noun,
        audit_event.c.noun_id: matching.noun_id,
        audit_event.c.project_id: matching.project_id,
        audit_event.c.mission_id: matching.mission_id,
        audit_event.c.as_admin: matching.as_admin,
    }
    globs = {audit_event.c.operation: matching.operation, person.c.name: matching.person, token.c.name: matching.token}
    names = person.c.name.label("actor_name"), token.c.name.label("token_name"), share.c.name.label("share_name")
    stmt = (
        select(audit_event, *names)
        .outerjoin(person, person.c.id == audit_event.c.actor_id)
        .outerjoin(token, token.c.id == audit_event.c.token_id)
        .outerjoin(share, share.c.id == audit_event.c.share_id)
        .where(*(column == value for column, value in same.items() if value is not None))
        .where(*(matches(column, glob) for column, glob in globs.items() if glob is not None))
    )
    if not actor.is_admin or actor.limits is not None:
        owned = union(
            visible_projects(actor, Right.delete).with_only_columns(project.c.id),
            trashed_projects(actor).with_only_columns(project.c.id),
        )
        stmt = stmt.where(audit_event.c.project_id.in_(owned))
    if matching.project_ids:
        stmt = stmt.where(audit_event.c.project_id.in_(matching.project_ids))
    if matching.mission_ids:
        stmt = stmt.where(audit_event.c.mission_id.in_(matching.mission_ids))
    if matching.since is not None:
        stmt = stmt.where(audit_event.c.at >= _aware(matching.since))
    return stmt if matching.until is None else stmt.where(audit_event.c.at < _aware(matching.until))


def _aware(at: datetime.datetime) -> datetime.datetime:
    return at if at.tzinfo else at.replace(tzinfo=datetime.timezone.utc)


def to_event(row: Row[Any], actor: Actor) -> AuditRead:
    """Return the event in a row of `matching_events`, as `actor` may see it."""
    # The address of a colleague is hidden; of guests, it is all that is known.
    shows_origin = actor.is_admin or row.actor_id is None or row.actor_id == actor.person_id
    return AuditRead(
        id=row.id,
        at=row.at,
        actor=PersonRef(id=row.actor_id, name=row.actor_name) if row.actor_id else None,
        token=CredentialRef(id=row.token_id, name=row.token_name) if row.token_id else None,
        share=CredentialRef(id=row.share_id, name=row.share_name or "") if row.share_id else None,
        session_id=row.session_id if shows_origin else None,
        address=row.address if shows_origin else None,
        as_admin=row.as_admin,
        operation=row.operation,
        noun=row.noun,
        noun_id=row.noun_id,
        noun_name=row.noun_name,
        project_id=row.project_id,
        mission_id=row.mission_id,
        before=row.before,
        after=row.after,
        request_id=row.request_id,
    )
