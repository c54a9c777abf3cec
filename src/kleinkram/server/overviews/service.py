"""Overviews: what a mission or a project is made of, in few queries and few bytes."""

import uuid

from kleinkram.contract.errors import NotFound
from kleinkram.contract.overviews import MissionTimeline
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection
from kleinkram.server.overviews import queries
from kleinkram.server.pagination import PageRequest, fetch_page


async def get_timeline(db: Connection, actor: Actor, *, mission_id: uuid.UUID, page: PageRequest) -> MissionTimeline:
    """Return when the files of a mission were recorded, by path.

    Raises:
        NotFound: the mission is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    span = (await db.execute(queries.mission_span(actor, mission_id))).one_or_none()
    if span is None:
        raise NotFound(noun="mission", ref=str(mission_id))
    rows = await fetch_page(db, queries.timeline_files(actor, mission_id), queries.TIMELINE_ORDER, page)
    items = [queries.to_timeline_file(row) for row in rows.items]
    return MissionTimeline(start_ns=span.start_ns, end_ns=span.end_ns, items=items, next=rows.next)
