"""Seeing that a project has room, and that it still has when what was asked for is there.

What a project uses is the files that it shows and the uploads under way into it. A file counts with all its bytes,
whether or not others share them. Whoever brings something in asks here after they hold the mission, before they hold
an upload, blob or file for it: then two cannot use the same room.
"""

import uuid
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, Select

from kleinkram.contract.errors import QuotaExceeded
from kleinkram.server.access.actor import Actor
from kleinkram.server.db import Connection
from kleinkram.server.quotas import queries


@dataclass(frozen=True)
class Amount:
    """Some files, and the bytes of all of them."""

    files: int
    size_bytes: int


async def require_room(db: Connection, actor: Actor, *, project_id: uuid.UUID, asked: Amount) -> None:
    """See that a project has room for more, and keep it from others until this transaction ends.

    Raises:
        QuotaExceeded: it has not.
    """
    row = (await db.execute(queries.quotas_of(actor, project_id))).one()
    if asked.files == 0 or (row.quota_bytes is None and row.quota_files is None):
        return
    await db.execute(queries.hold_room(project_id))
    used = await _amount(db, queries.used_by_project(project_id))
    _see_that_it_fits(row, "files", asked=asked.files, used=used.files, quota=row.quota_files)
    _see_that_it_fits(row, "bytes", asked=asked.size_bytes, used=used.size_bytes, quota=row.quota_bytes)


async def require_room_for_mission(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, mission_id: uuid.UUID
) -> None:
    """See that a project has room for all of a mission that comes into it, as `require_room` does.

    Raises:
        QuotaExceeded: it has not.
    """
    asked = await _amount(db, queries.used_by_mission(mission_id))
    await require_room(db, actor, project_id=project_id, asked=asked)


async def project_of(db: Connection, mission_id: uuid.UUID) -> uuid.UUID:
    """Return the id of the project that a mission is in."""
    project_id: uuid.UUID = (await db.execute(queries.project_of(mission_id))).scalar_one()
    return project_id


async def _amount(db: Connection, statement: Select[Any]) -> Amount:
    row = (await db.execute(statement)).one()
    return Amount(row.files, int(row.size_bytes))


def _see_that_it_fits(row: Row[Any], unit: str, *, asked: int, used: int, quota: int | None) -> None:
    if quota is None or used + asked <= quota:
        return
    told = (used, quota) if row.is_known else (None, None)
    raise QuotaExceeded(project=row.name, unit=unit, requested=asked, used=told[0], quota=told[1])
