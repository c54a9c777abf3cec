"""What is asked for overviews. Functions return selects; they touch no connection."""

import uuid
from typing import Any

from sqlalchemy import Row, Select

from kleinkram.contract.timelines import TimelineFile
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import shown_span, visible_files, visible_missions
from kleinkram.server.pages import Order
from kleinkram.server.tables import blob, file, mission

TIMELINE_ORDER = Order([file.c.path, file.c.id])


def mission_span(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return `start_ns` and `end_ns` of one visible mission, as far as its files are shown."""
    start_ns, end_ns = shown_span(actor)
    columns = (start_ns.label("start_ns"), end_ns.label("end_ns"))
    return (
        visible_missions(actor)
        .with_only_columns(*columns, maintain_column_froms=True)
        .where(mission.c.id == mission_id)
    )


def timeline_files(actor: Actor, mission_id: uuid.UUID) -> Select[Any]:
    """Return the visible files of one mission, as `to_timeline_file` reads them."""
    columns = (file.c.id, file.c.path, file.c.recording_id)
    known = (blob.c.start_ns, blob.c.end_ns, blob.c.size_bytes, blob.c.content, blob.c.state)
    stmt = visible_files(actor).with_only_columns(*columns, *known, maintain_column_froms=True)
    return stmt.where(mission.c.id == mission_id)


def to_timeline_file(row: Row[Any]) -> TimelineFile:
    """Return the file that a row of `timeline_files` stands for."""
    return TimelineFile(
        id=row.id,
        path=row.path,
        recording_id=row.recording_id,
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        size_bytes=row.size_bytes,
        content=row.content,
        state=row.state,
    )
