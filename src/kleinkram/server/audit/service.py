"""Reading the audit log: lists and exports of the events that an actor may see."""

import datetime
from collections.abc import AsyncIterator
from typing import Any

from sqlalchemy import Row, Select, union

from kleinkram.contract.access import Right
from kleinkram.contract.audit import AuditFilter, AuditRead, CredentialRef
from kleinkram.contract.base import Page
from kleinkram.contract.people import PersonRef
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import trashed_projects, visible_projects
from kleinkram.server.db import Connection, Database, matches
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.tables import audit_event, person, project, share, token

_LATEST_FIRST = Order([audit_event.c.id], descending=True)
_EXPORT_BATCH = 500


async def list_events(db: Connection, actor: Actor, *, matching: AuditFilter, page: PageRequest) -> Page[AuditRead]:
    """Return a page of the events that match, latest first. Raises InvalidCursor."""
    return await read_page(db, _matching_events(actor, matching), _LATEST_FIRST, page, lambda row: _read(row, actor))


async def export_events(database: Database, actor: Actor, *, matching: AuditFilter) -> AsyncIterator[AuditRead]:
    """Yield the events that match, oldest first, with at most `_EXPORT_BATCH` in memory.

    Each batch has its own transaction, so that a slow reader holds no connection. Events that are added during the
    export may or may not be included.
    """
    last_id = 0
    while True:
        stmt = _matching_events(actor, matching).where(audit_event.c.id > last_id)
        async with database.begin() as db:
            rows = (await db.execute(stmt.order_by(audit_event.c.id).limit(_EXPORT_BATCH))).all()
        for row in rows:
            yield _read(row, actor)
        if len(rows) < _EXPORT_BATCH:
            return
        last_id = rows[-1].id


def _matching_events(actor: Actor, matching: AuditFilter) -> Select[Any]:
    """Return the events that match and that `actor` may see: those of projects they own; for admins, all."""
    equal = {
        audit_event.c.actor_id: matching.person_id,
        audit_event.c.token_id: matching.token_id,
        audit_event.c.share_id: matching.share_id,
        audit_event.c.resource_type: matching.resource_type,
        audit_event.c.resource_id: matching.resource_id,
        audit_event.c.project_id: matching.project_id,
        audit_event.c.mission_id: matching.mission_id,
        audit_event.c.as_admin: matching.as_admin,
    }
    globs = {audit_event.c.operation: matching.operation, person.c.name: matching.person, token.c.name: matching.token}
    names = person.c.name.label("actor_name"), token.c.name.label("token_name"), share.c.name.label("share_name")
    stmt = (
        audit_event.select()
        .add_columns(*names)
        .outerjoin(person, person.c.id == audit_event.c.actor_id)
        .outerjoin(token, token.c.id == audit_event.c.token_id)
        .outerjoin(share, share.c.id == audit_event.c.share_id)
        .where(*(column == value for column, value in equal.items() if value is not None))
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


def _read(row: Row[Any], actor: Actor) -> AuditRead:
    """Return the event in a row of `_matching_events`, as `actor` may see it."""
    # The address of a colleague is hidden; of guests, it is all that is known.
    shows_origin = actor.is_admin or row.actor_id is None or row.actor_id == actor.person_id
    hidden = {} if shows_origin else {"session_id": None, "address": None}
    refs = {
        "actor": PersonRef(id=row.actor_id, name=row.actor_name) if row.actor_id else None,
        "token": CredentialRef(id=row.token_id, name=row.token_name) if row.token_id else None,
        "share": CredentialRef(id=row.share_id, name=row.share_name or "") if row.share_id else None,
    }
    values = {name: value for name, value in row._mapping.items() if name in AuditRead.model_fields}
    return AuditRead.model_validate({**values, **refs, **hidden})
