"""What is asked of links. Functions return selects; they touch no connection."""

import uuid
from collections.abc import Collection
from typing import Any

from sqlalchemy import Row, Select, Update, case, false, func, select, update

from kleinkram.contract.missions import MissionRef
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.rights import Right
from kleinkram.contract.shares import SharedRead, ShareRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import visible_files, visible_missions
from kleinkram.server.db import among
from kleinkram.server.paging import Order
from kleinkram.server.tables import blob, file, mission, person, project, share, share_file

# Latest first.
SHARE_ORDER = Order([share.c.created_at, share.c.id], descending=True)

_PLACE = (mission.c.name.label("mission_name"), project.c.id.label("project_id"), project.c.name.label("project_name"))


def known_shares(actor: Actor, right: Right = Right.write) -> Select[Any]:
    """Return the links that `actor` made, and those to missions on which they have a right.

    What somebody made they find again whatever became of the mission, or of their rights on it; not by a token that
    is limited to other places.
    """
    files = select(func.count()).where(share_file.c.share_id == share.c.id).correlate(share).scalar_subquery()
    own = [column for column in share.c if column is not share.c.secret_sha256]
    count = case((share.c.is_whole, None), else_=files).label("file_count")
    joined = (
        select(*own, *_PLACE, person.c.name.label("created_by_name"), count)
        .join_from(share, mission, mission.c.id == share.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(person, person.c.id == share.c.created_by_id)
    )
    held = visible_missions(actor, right).with_only_columns(mission.c.id, maintain_column_froms=True)
    made = share.c.created_by_id == actor.person_id if actor.limits is None else false()
    return joined.where(made | share.c.mission_id.in_(held))


def still_usable(stmt: Select[Any]) -> Select[Any]:
    """Return those of a select's links that have neither been revoked nor expired."""
    return stmt.where(share.c.revoked_at.is_(None), share.c.expires_at > func.now())


def files_of(actor: Actor, mission_id: uuid.UUID, file_ids: Collection[uuid.UUID]) -> Select[Any]:
    """Return the ids of those of some files that are in a mission, and shown to `actor`."""
    seen = visible_files(actor).with_only_columns(file.c.id, maintain_column_froms=True)
    return seen.where(file.c.mission_id == mission_id, among(file.c.id, file_ids))


def shown(actor: Actor) -> Select[Any]:
    """Return what the link of `actor` shows, as `to_shared` reads it; nothing where they came by none."""
    amounts = (func.count(file.c.id).label("file_count"), func.coalesce(func.sum(blob.c.size_bytes), 0).label("bytes"))
    seen = visible_files(actor).with_only_columns(file.c.id, file.c.mission_id, maintain_column_froms=True).subquery()
    stmt = visible_missions(actor).with_only_columns(
        share.c.name, share.c.is_whole, share.c.expires_at, mission.c.id, *_PLACE, *amounts, maintain_column_froms=True
    )
    joined = stmt.join(share, share.c.mission_id == mission.c.id).outerjoin(seen, seen.c.mission_id == mission.c.id)
    joined = joined.outerjoin(file, file.c.id == seen.c.id).outerjoin(blob, blob.c.id == file.c.blob_id)
    return joined.where(share.c.id == actor.share_id).group_by(share.c.id, mission.c.id, project.c.id)


def count_downloads(share_id: uuid.UUID, *, files: int, size_bytes: int) -> Update:
    """Return the statement that counts files that were fetched by a link."""
    counted = {
        "download_count": share.c.download_count + files,
        "download_bytes": share.c.download_bytes + size_bytes,
    }
    return update(share).where(share.c.id == share_id).values(**counted)


def to_share(row: Row[Any]) -> ShareRead:
    """Return the link that a row of `known_shares` stands for."""
    return ShareRead(
        id=row.id,
        name=row.name,
        mission=_mission(row, row.mission_id),
        file_count=row.file_count,
        prefix=row.prefix,
        created_by=PersonRef(id=row.created_by_id, name=row.created_by_name),
        created_at=row.created_at,
        expires_at=row.expires_at,
        revoked_at=row.revoked_at,
        last_used_at=row.last_used_at,
        download_count=row.download_count,
        download_bytes=row.download_bytes,
    )


def to_shared(row: Row[Any]) -> SharedRead:
    """Return what a row of `shown` stands for."""
    return SharedRead(
        name=row.name,
        mission=_mission(row, row.id),
        is_whole=row.is_whole,
        file_count=row.file_count,
        size_bytes=int(row.bytes),
        expires_at=row.expires_at,
    )


def _mission(row: Row[Any], mission_id: uuid.UUID) -> MissionRef:
    project_ref = ProjectRef(id=row.project_id, name=row.project_name)
    return MissionRef(id=mission_id, name=row.mission_name, project=project_ref)
