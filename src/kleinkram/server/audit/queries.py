"""What is asked of the record. Functions return selects; they touch no connection."""

import uuid
from typing import Any

from sqlalchemy import Row, Select, select, union

from kleinkram.contract.audit import AuditRead
from kleinkram.contract.people import PersonRef
from kleinkram.contract.rights import Right
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import trashed_projects, visible_projects
from kleinkram.server.pages import Order
from kleinkram.server.tables import audit_event, person, project

# Latest first.
AUDIT_ORDER = Order([audit_event.c.id], descending=True)


def visible_events(actor: Actor) -> Select[Any]:
    """Return the events that `actor` may see: those of projects they own; admins see all."""
    name = person.c.name.label("actor_name")
    stmt = select(audit_event, name).outerjoin(person, person.c.id == audit_event.c.actor_id)
    if actor.is_admin and actor.limits is None:
        return stmt
    owned = union(
        visible_projects(actor, Right.delete).with_only_columns(project.c.id),
        trashed_projects(actor).with_only_columns(project.c.id),
    )
    return stmt.where(audit_event.c.project_id.in_(owned))


def events_about(
    actor: Actor, *, noun: str | None, noun_id: uuid.UUID | None, project_id: uuid.UUID | None
) -> Select[Any]:
    """Return the visible events about what is given."""
    stmt = visible_events(actor)
    stmt = stmt if noun is None else stmt.where(audit_event.c.noun == noun)
    stmt = stmt if noun_id is None else stmt.where(audit_event.c.noun_id == noun_id)
    return stmt if project_id is None else stmt.where(audit_event.c.project_id == project_id)


def to_event(row: Row[Any]) -> AuditRead:
    """Return the event that a row stands for."""
    return AuditRead(
        id=row.id,
        at=row.at,
        actor=PersonRef(id=row.actor_id, name=row.actor_name) if row.actor_id else None,
        operation=row.operation,
        noun=row.noun,
        noun_id=row.noun_id,
        noun_name=row.noun_name,
        project_id=row.project_id,
        before=row.before,
        after=row.after,
        request_id=row.request_id,
    )
