"""What is asked of the record. Functions return selects; they touch no connection."""

import datetime
import uuid
from collections.abc import Sequence
from typing import Any, NamedTuple

from sqlalchemy import (
    ARRAY,
    Boolean,
    ColumnElement,
    Integer,
    Row,
    ScalarSelect,
    Select,
    Uuid,
    column,
    func,
    literal,
    select,
    union,
)
from sqlalchemy.dialects.postgresql import aggregate_order_by

from kleinkram.contract.audit import AuditFilter, AuditRead, CredentialRef
from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import level_on_mission, level_on_project, trashed_projects, visible_projects
from kleinkram.server.db import unnest_rows
from kleinkram.server.filters.patterns import matches
from kleinkram.server.paging import Order
from kleinkram.server.tables import audit_event, mission, person, project, share, token

# Latest first; an export is the other way round.
AUDIT_ORDER = Order([audit_event.c.id], descending=True)


class Place(NamedTuple):
    """Where something happened, and the level of right that it took there."""

    project_id: uuid.UUID | None
    mission_id: uuid.UUID | None
    needed: int


def lacks_own_right(admin: Actor, places: Sequence[Place]) -> ScalarSelect[Sequence[bool]]:
    """Say of each place whether `admin` would have been refused without their power: an array, in order.

    Worked out once a statement, however many events of it happened there.
    """
    columns = [column("number", Integer), column("project_id", Uuid), column("mission_id", Uuid)]
    rows = [{"number": number, **place._asdict()} for number, place in enumerate(places)]
    place = unnest_rows([*columns, column("needed", Integer)], rows)
    by_mission = _own_level_on_mission(admin, place.c.mission_id)
    by_project = _own_level_on_project(admin, place.c.project_id)
    is_lacking = func.coalesce(by_mission, by_project, literal(0)) < place.c.needed
    in_order = aggregate_order_by(is_lacking, place.c.number)
    return select(func.array_agg(in_order, type_=ARRAY(Boolean))).select_from(place).scalar_subquery()


def _own_level_on_mission(admin: Actor, mission_id: ColumnElement[Any]) -> ColumnElement[int]:
    level = select(level_on_mission(admin.without_power())).select_from(mission.join(project))
    return level.where(mission.c.id == mission_id).correlate_except(mission, project).scalar_subquery()


def _own_level_on_project(admin: Actor, project_id: ColumnElement[Any]) -> ColumnElement[int]:
    level = select(level_on_project(admin.without_power())).select_from(project)
    return level.where(project.c.id == project_id).correlate_except(project).scalar_subquery()


def visible_events(actor: Actor) -> Select[Any]:
    """Return the events that `actor` may see: those of projects they own; admins see all."""
    names = (
        person.c.name.label("actor_name"),
        token.c.name.label("token_name"),
        share.c.name.label("share_name"),
    )
    stmt = (
        select(audit_event, *names)
        .outerjoin(person, person.c.id == audit_event.c.actor_id)
        .outerjoin(token, token.c.id == audit_event.c.token_id)
        .outerjoin(share, share.c.id == audit_event.c.share_id)
    )
    if actor.is_admin and actor.limits is None:
        return stmt
    owned = union(
        visible_projects(actor, Right.delete).with_only_columns(project.c.id),
        trashed_projects(actor).with_only_columns(project.c.id),
    )
    return stmt.where(audit_event.c.project_id.in_(owned))


def matching_events(actor: Actor, matching: AuditFilter) -> Select[Any]:
    """Return the visible events that match."""
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
    named = {audit_event.c.operation: matching.operation, person.c.name: matching.person, token.c.name: matching.token}
    stmt = visible_events(actor)
    stmt = stmt.where(*(column == value for column, value in same.items() if value is not None))
    stmt = stmt.where(*(matches(column, glob) for column, glob in named.items() if glob is not None))
    if matching.project_ids:
        stmt = stmt.where(audit_event.c.project_id.in_(matching.project_ids))
    if matching.mission_ids:
        stmt = stmt.where(audit_event.c.mission_id.in_(matching.mission_ids))
    if matching.since is not None:
        stmt = stmt.where(audit_event.c.at >= _aware(matching.since))
    return stmt if matching.until is None else stmt.where(audit_event.c.at < _aware(matching.until))


def events_after(actor: Actor, matching: AuditFilter, *, event_id: int, limit: int) -> Select[Any]:
    """Return the visible events that match and came after another, oldest first."""
    stmt = matching_events(actor, matching).where(audit_event.c.id > event_id)
    return stmt.order_by(audit_event.c.id).limit(limit)


def _aware(at: datetime.datetime) -> datetime.datetime:
    return at if at.tzinfo else at.replace(tzinfo=datetime.timezone.utc)


def to_event(row: Row[Any], actor: Actor) -> AuditRead:
    """Return the event that a row stands for, as `actor` may see it."""
    # Where a colleague works from is nobody's business; of somebody without a name it is all that is known.
    is_open = actor.is_admin or row.actor_id is None or row.actor_id == actor.person_id
    return AuditRead(
        id=row.id,
        at=row.at,
        actor=PersonRef(id=row.actor_id, name=row.actor_name) if row.actor_id else None,
        token=CredentialRef(id=row.token_id, name=row.token_name) if row.token_id else None,
        share=CredentialRef(id=row.share_id, name=row.share_name or "") if row.share_id else None,
        session_id=row.session_id if is_open else None,
        address=row.address if is_open else None,
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
