"""Reading the record. Apart from writing it, which everything else needs."""

import uuid

from kleinkram.contract.audit import AuditRead
from kleinkram.contract.paging import Page
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit import queries
from kleinkram.server.db import Connection
from kleinkram.server.pages import PageRequest, fetch_page


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
