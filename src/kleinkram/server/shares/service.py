"""Share links: creating, listing, revoking. Secrets leave the server once, in the response that creates them."""

import datetime
import uuid
from typing import Any

from sqlalchemy import Row, Select, case, false, func, insert, select, update

from kleinkram.contract.access import Right
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, InvalidRequest, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.people import PersonRef
from kleinkram.contract.token_format import SecretKind
from kleinkram.contract.tokens import SHARE_PAGE, ShareCreate, SharedRead, ShareMade, ShareRead
from kleinkram.server.access.actor import Actor, new_secret
from kleinkram.server.access.rights import ensure_active_person, require_mission
from kleinkram.server.access.visible import visible_files, visible_missions
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, among
from kleinkram.server.missions.queries import mission_ref
from kleinkram.server.missions.service import lock_mission
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.settings import Settings
from kleinkram.server.tables import blob, file, mission, person, project, share, share_file

_SHARE_ORDER = Order([share.c.created_at, share.c.id], descending=True)
# The arguments of `mission_ref`.
_MISSION_COLUMNS = (
    mission.c.id.label("mission_id"),
    mission.c.name.label("mission_name"),
    project.c.id.label("project_id"),
    project.c.name.label("project_name"),
)


async def create_share(
    db: Connection, actor: Actor, *, settings: Settings, mission_id: uuid.UUID, request: ShareCreate
) -> ShareMade:
    """Create a link and return it with its secret. Raises NotFound, Forbidden, InvalidRequest or NotAuthenticated."""
    await ensure_active_person(db, actor.person_id)
    await lock_mission(db, mission_id)
    await require_mission(db, actor, "create_share", mission_id)
    await _require_valid_expiry(db, request.expires_at, max_days=settings.share_days_max)
    file_ids = None if request.file_ids is None else list(dict.fromkeys(request.file_ids))
    files = visible_files(actor).with_only_columns(file.c.id, maintain_column_froms=True)
    files = files.where(file.c.mission_id == mission_id, among(file.c.id, file_ids or []))
    visible = set((await db.execute(files)).scalars())
    if missing := [file_id for file_id in file_ids or [] if file_id not in visible]:
        raise NotFound(resource_type="file", ref=str(missing[0]))
    share_id, secret = uuid.uuid4(), new_secret(SecretKind.link)
    await db.execute(
        insert(share).values(
            id=share_id,
            mission_id=mission_id,
            name=request.name,
            is_whole_mission=file_ids is None,
            prefix=secret.prefix,
            secret_sha256=secret.sha256,
            created_by_id=actor.person_id,
            expires_at=request.expires_at,
        )
    )
    if file_ids:
        await db.execute(insert(share_file), [{"share_id": share_id, "file_id": file_id} for file_id in file_ids])
    created = await _get_share(db, _known_shares(actor, Right.write), share_id)
    after: Metadata = created.model_dump(mode="json", include={"file_count", "expires_at", "prefix"})
    after["file_ids"] = None if file_ids is None else [str(file_id) for file_id in file_ids]
    await audit(db, actor, _event("share.create", created, after))
    url = f"{settings.public_url.rstrip('/')}{SHARE_PAGE}#{secret.text}"
    return ShareMade(share=created, url=url, secret=secret.text)


async def list_shares(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID | None, with_ended: bool, page: PageRequest
) -> Page[ShareRead]:
    """Return a page of the links that the actor may revoke, latest first. Raises InvalidCursor."""
    stmt = _known_shares(actor, Right.write)
    if not with_ended:
        stmt = stmt.where(share.c.revoked_at.is_(None), share.c.expires_at > func.now())
    stmt = stmt if mission_id is None else stmt.where(share.c.mission_id == mission_id)
    return await read_page(db, stmt, _SHARE_ORDER, page, _to_share)


async def revoke_share(db: Connection, actor: Actor, *, share_id: uuid.UUID) -> None:
    """Revoke a link, from the next request on. Raises NotFound or Forbidden."""
    old = await _get_share(db, _known_shares(actor, Right.read), share_id)
    if old.created_by.id != actor.person_id:
        await require_mission(db, actor, "revoke_share", old.mission.id)
    stmt = update(share).where(share.c.id == share_id, share.c.revoked_at.is_(None)).values(revoked_at=func.now())
    if (await db.execute(stmt.returning(share.c.id))).first() is not None:
        await audit(db, actor, _event("share.revoke", old, {"prefix": old.prefix}))


async def get_shared(db: Connection, actor: Actor) -> SharedRead:
    """Return what the actor's own link shows. Raises NotFound if they have none."""
    amounts = (func.count(file.c.id).label("file_count"), func.coalesce(func.sum(blob.c.size_bytes), 0).label("bytes"))
    seen = visible_files(actor).with_only_columns(file.c.id, file.c.mission_id, maintain_column_froms=True).subquery()
    stmt = visible_missions(actor).with_only_columns(
        share.c.name,
        share.c.is_whole_mission,
        share.c.expires_at,
        *_MISSION_COLUMNS,
        *amounts,
        maintain_column_froms=True,
    )
    joined = stmt.join(share, share.c.mission_id == mission.c.id).outerjoin(seen, seen.c.mission_id == mission.c.id)
    joined = joined.outerjoin(file, file.c.id == seen.c.id).outerjoin(blob, blob.c.id == file.c.blob_id)
    own = joined.where(share.c.id == actor.share_id).group_by(share.c.id, mission.c.id, project.c.id)
    row = (await db.execute(own)).one_or_none()
    if row is None:
        raise NotFound(resource_type="link", ref="of this request")
    return SharedRead(
        name=row.name,
        mission=mission_ref(row.mission_id, row.mission_name, row.project_id, row.project_name),
        is_whole_mission=row.is_whole_mission,
        file_count=row.file_count,
        size_bytes=int(row.bytes),
        expires_at=row.expires_at,
    )


async def count_downloads(db: Connection, actor: Actor, *, files: int, size_bytes: int) -> None:
    """Count the files that an actor downloads with a link."""
    if actor.share_id is not None:
        counts = {
            "download_count": share.c.download_count + files,
            "download_bytes": share.c.download_bytes + size_bytes,
        }
        await db.execute(update(share).where(share.c.id == actor.share_id).values(**counts))


def _known_shares(actor: Actor, right: Right) -> Select[Any]:
    """Return the links that the actor created, and those to missions on which they have a right.

    Actors find their own links whatever happened to the mission or their rights, but not with a limited token.
    """
    files = select(func.count()).where(share_file.c.share_id == share.c.id).correlate(share).scalar_subquery()
    own = [column for column in share.c if column.name not in {"secret_sha256", "mission_id"}]
    count = case((share.c.is_whole_mission, None), else_=files).label("file_count")
    joined = (
        select(*own, *_MISSION_COLUMNS, person.c.name.label("created_by_name"), count)
        .join_from(share, mission, mission.c.id == share.c.mission_id)
        .join(project, project.c.id == mission.c.project_id)
        .join(person, person.c.id == share.c.created_by_id)
    )
    missions = visible_missions(actor, right).with_only_columns(mission.c.id, maintain_column_froms=True)
    is_own = share.c.created_by_id == actor.person_id if actor.limits is None else false()
    return joined.where(is_own | share.c.mission_id.in_(missions))


async def _get_share(db: Connection, known: Select[Any], share_id: uuid.UUID) -> ShareRead:
    row = (await db.execute(known.where(share.c.id == share_id))).one_or_none()
    if row is None:
        raise NotFound(resource_type="link", ref=str(share_id))
    return _to_share(row)


def _to_share(row: Row[Any]) -> ShareRead:
    return ShareRead(
        id=row.id,
        name=row.name,
        mission=mission_ref(row.mission_id, row.mission_name, row.project_id, row.project_name),
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


async def _require_valid_expiry(db: Connection, expires_at: datetime.datetime, *, max_days: int) -> None:
    now = (await db.execute(select(func.now()))).scalar_one()
    if expires_at <= now:
        message = "is in the past; a link must expire later than now"
    elif expires_at > now + datetime.timedelta(days=max_days):
        message = f"is too far off; links of this server are good for {max_days} days at most"
    else:
        return
    raise InvalidRequest(problems=[FieldProblem(field="expires_at", message=message)])


def _event(operation: str, shared: ShareRead, after: Metadata) -> Event:
    ref = shared.mission
    return Event(operation, "share", shared.id, shared.name, ref.project.id, after=after, mission_id=ref.id)
