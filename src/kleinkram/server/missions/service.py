"""What may be done with missions. A mission comes to be only with metadata that satisfies its project."""

import uuid
from typing import Any

from sqlalchemy import Row

from kleinkram.contract.errors import NotFound
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection
from kleinkram.server.missions import queries


async def get_mission_row(db: Connection, actor: Actor, mission_id: uuid.UUID) -> Row[Any]:
    """Return the row of a mission, with `project_name` and the project's `metadata_fields`.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    row = (await db.execute(queries.mission_by_id(actor, mission_id))).one_or_none()
    if row is None:
        raise NotFound(noun="mission", ref=str(mission_id))
    return row
