"""Writing the record, and reading it."""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field

from sqlalchemy import insert

from kleinkram.contract.audit import AuditRead
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.paging import Page
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit import queries
from kleinkram.server.db import Connection
from kleinkram.server.pages import PageRequest, fetch_page
from kleinkram.server.tables import audit_event


@dataclass(frozen=True)
class Event:
    """What happened to one thing: `operation` is `<noun>.<verb>`; before and after hold only what changed."""

    operation: str
    noun: str
    noun_id: uuid.UUID | None
    noun_name: str
    project_id: uuid.UUID | None
    before: Metadata = field(default_factory=dict)
    after: Metadata = field(default_factory=dict)


async def record(db: Connection, actor: Actor | None, *events: Event, request_id: str | None = None) -> None:
    """Add events to the record, as part of the caller's transaction.

    `actor` is None for the server's own jobs, and where nobody knows who asked: then `request_id` is the request's.
    """
    await record_all(db, actor, events, request_id=request_id)


async def record_all(
    db: Connection, actor: Actor | None, events: Sequence[Event], *, request_id: str | None = None
) -> None:
    """Add many events to the record, as part of the caller's transaction."""
    if not events:
        return
    who: dict[str, object] = {"request_id": request_id}
    if actor is not None:
        who = {
            "actor_id": actor.person_id,
            "token_id": actor.token_id,
            "session_id": actor.session_id,
            "share_id": actor.share_id,
            "address": actor.address,
            "request_id": actor.request_id,
        }
    await db.execute(insert(audit_event), [{**vars(event), **who} for event in events])


async def list_events(
    db: Connection,
    actor: Actor,
    *,
    page: PageRequest,
    noun: str | None = None,
    noun_id: uuid.UUID | None = None,
    project_id: uuid.UUID | None = None,
) -> Page[AuditRead]:
    """Return a page of events, latest first.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    statement = queries.events_about(actor, noun=noun, noun_id=noun_id, project_id=project_id)
    rows = await fetch_page(db, statement, queries.AUDIT_ORDER, page)
    return Page(items=[queries.to_event(row) for row in rows.items], next=rows.next, total=rows.total)
