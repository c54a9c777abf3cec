"""What quotas ask of the database. Functions return selects; they touch no connection."""

import uuid
from typing import Any

from sqlalchemy import Select, func, literal, select, union_all

from kleinkram.contract.rights import Scope
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_projects
from kleinkram.server.tables import blob, file, mission, project, upload
from kleinkram.server.tables.blobs import UNDER_WAY

# The first half of the keys of the locks below.
_ROOM = 0x6B6C5155


def project_of(mission_id: uuid.UUID) -> Select[Any]:
    """Return the id of the project that a mission is in."""
    return select(mission.c.project_id).where(mission.c.id == mission_id)


def quotas_of(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    """Return a project's name and quotas, and whether `actor` may know its numbers."""
    seen = visible_projects(actor).with_only_columns(project.c.id).where(project.c.id == project_id)
    is_known = literal(Scope.read in actor.scopes) & seen.exists()
    return select(project.c.name, project.c.quota_bytes, project.c.quota_files, is_known.label("is_known")).where(
        project.c.id == project_id
    )


def hold_room(project_id: uuid.UUID) -> Select[Any]:
    """Return the select that keeps others from using room in a project until the transaction ends.

    Not the project's row: whoever fills a mission holds that only so far that it stays, and may not take more of it
    while they hold the mission, since others take the two the other way round.
    """
    key = int.from_bytes(project_id.bytes[:4], "big", signed=True)
    return select(func.pg_advisory_xact_lock(_ROOM, key))


def used_by_project(project_id: uuid.UUID) -> Select[Any]:
    """Return the number and bytes of the files in a project and of the uploads under way into it."""
    return _used(select(mission.c.id).where(mission.c.project_id == project_id, mission.c.deleted_at.is_(None)))


def used_by_mission(mission_id: uuid.UUID) -> Select[Any]:
    """Return the same of a mission, in the trash or not."""
    return _used(select(mission.c.id).where(mission.c.id == mission_id))


def _used(missions: Select[Any]) -> Select[Any]:
    # By one statement, which sees an upload or the file that it became, never neither.
    files = select(blob.c.size_bytes).join_from(file, blob, blob.c.id == file.c.blob_id)
    uploads = select(upload.c.size_bytes).where(upload.c.state.in_(UNDER_WAY), upload.c.mission_id.in_(missions))
    live = files.where(file.c.deleted_at.is_(None), file.c.mission_id.in_(missions))
    each = union_all(live, uploads).subquery("each")
    return select(func.count().label("files"), func.coalesce(func.sum(each.c.size_bytes), 0).label("size_bytes"))
