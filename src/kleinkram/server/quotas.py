"""Quotas of projects, which count visible files and open uploads.

Call these after locking the mission and before locking an upload, blob or file, so that two requests cannot use the
same space.
"""

import uuid
from typing import NamedTuple

from sqlalchemy import Select, func, literal, select, union_all

from kleinkram.contract.access import Scope
from kleinkram.contract.errors import QuotaExceeded
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_projects
from kleinkram.server.db import Connection
from kleinkram.server.tables import blob, file, mission, project, upload
from kleinkram.server.tables.blobs import UNDER_WAY

# The first half of the keys of the advisory locks.
_LOCK_CLASS = 0x6B6C5155


class Amount(NamedTuple):
    """A number of files and the sum of their bytes."""

    files: int
    size_bytes: int


async def require_room(db: Connection, actor: Actor, *, project_id: uuid.UUID, requested: Amount) -> None:
    """Require that a project has room for more, and lock that room until this transaction ends.

    Raises QuotaExceeded.
    """
    seen = visible_projects(actor).with_only_columns(project.c.id).where(project.c.id == project_id)
    is_known = (literal(Scope.read in actor.scopes) & seen.exists()).label("is_known")
    stmt = select(project.c.name, project.c.quota_bytes, project.c.quota_files, is_known)
    row = (await db.execute(stmt.where(project.c.id == project_id))).one()
    if requested.files == 0 or (row.quota_bytes is None and row.quota_files is None):
        return
    # Not the project's row: uploads lock it for share only, and other transactions lock the two in reverse order.
    key = int.from_bytes(project_id.bytes[:4], "big", signed=True)
    await db.execute(select(func.pg_advisory_xact_lock(_LOCK_CLASS, key)))
    missions = select(mission.c.id).where(mission.c.project_id == project_id, mission.c.deleted_at.is_(None))
    used = await _amount_in(db, missions)
    for unit, amount, present, quota in (
        ("files", requested.files, used.files, row.quota_files),
        ("bytes", requested.size_bytes, used.size_bytes, row.quota_bytes),
    ):
        if quota is not None and present + amount > quota:
            shown = (present, quota) if row.is_known else (None, None)
            raise QuotaExceeded(project=row.name, unit=unit, requested=amount, used=shown[0], quota=shown[1])


async def require_room_for_mission(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, mission_id: uuid.UUID
) -> None:
    """Require that a project has room for a mission, in the trash or not, as `require_room` does."""
    requested = await _amount_in(db, select(mission.c.id).where(mission.c.id == mission_id))
    await require_room(db, actor, project_id=project_id, requested=requested)


async def project_of(db: Connection, mission_id: uuid.UUID) -> uuid.UUID:
    """Return the id of the project that a mission is in."""
    stmt = select(mission.c.project_id).where(mission.c.id == mission_id)
    project_id: uuid.UUID = (await db.execute(stmt)).scalar_one()
    return project_id


async def _amount_in(db: Connection, missions: Select[tuple[uuid.UUID]]) -> Amount:
    # One statement, so that an upload that becomes a file is counted.
    files = select(blob.c.size_bytes).join_from(file, blob, blob.c.id == file.c.blob_id)
    uploads = select(upload.c.size_bytes).where(upload.c.state.in_(UNDER_WAY), upload.c.mission_id.in_(missions))
    live = files.where(file.c.deleted_at.is_(None), file.c.mission_id.in_(missions))
    sizes = union_all(live, uploads).subquery("sizes")
    stmt = select(func.count().label("files"), func.coalesce(func.sum(sizes.c.size_bytes), 0).label("size_bytes"))
    row = (await db.execute(stmt)).one()
    return Amount(row.files, int(row.size_bytes))
