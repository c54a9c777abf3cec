"""What is asked of links. Functions return selects; they touch no connection."""

import datetime
import uuid
from collections.abc import Collection
from typing import Any

from sqlalchemy import Row, Select, Update, case, false, func, insert, select, update

from kleinkram.contract.access import Right
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, InvalidRequest, NotFound
from kleinkram.contract.missions import MissionRef
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.contract.tokens import SHARE_PAGE, SecretKind, ShareCreate, SharedRead, ShareMade, ShareRead
from kleinkram.server.access.actor import Actor, new_secret
from kleinkram.server.access.rights import ensure_active_person, require_mission
from kleinkram.server.access.visible import visible_files, visible_missions
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection, among
from kleinkram.server.missions.service import lock_mission
from kleinkram.server.paging import Order, PageRequest, fetch_page
from kleinkram.server.settings import Settings
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


async def create_share(
    db: Connection, actor: Actor, *, settings: Settings, mission_id: uuid.UUID, wanted: ShareCreate
) -> ShareMade:
    """Make a link and return it with its secret.

    Raises:
        NotFound: the mission, or one of the files in it, is not there, or not for this actor.
        Forbidden: they may see the mission, but not share it.
        InvalidRequest: it would have expired already, or lasts longer than the settings allow.
        NotAuthenticated: whoever makes it left meanwhile.
    """
    await ensure_active_person(db, actor.person_id)
    await lock_mission(db, mission_id)
    await require_mission(db, actor, "create_share", mission_id)
    await _see_that_it_ends(db, wanted.expires_at, within_days=settings.share_days_max)
    file_ids = None if wanted.file_ids is None else list(dict.fromkeys(wanted.file_ids))
    await _see_that_files_are_there(db, actor, mission_id, file_ids or [])
    share_id, secret = uuid.uuid4(), new_secret(SecretKind.link)
    await db.execute(
        insert(share).values(
            id=share_id,
            mission_id=mission_id,
            name=wanted.name,
            is_whole=file_ids is None,
            prefix=secret.prefix,
            secret_sha256=secret.sha256,
            created_by_id=actor.person_id,
            expires_at=wanted.expires_at,
        )
    )
    if file_ids:
        await db.execute(insert(share_file), [{"share_id": share_id, "file_id": each} for each in file_ids])
    made = to_share(await _row(db, known_shares(actor), share_id))
    after = made.model_dump(mode="json", include={"file_count", "expires_at", "prefix"})
    after["file_ids"] = None if file_ids is None else [str(each) for each in file_ids]
    await record(db, actor, _event("share.create", made, after=after))
    url = f"{settings.public_url.rstrip('/')}{SHARE_PAGE}#{secret.text}"
    return ShareMade(share=made, url=url, secret=secret.text)


async def list_shares(
    db: Connection, actor: Actor, *, mission_id: uuid.UUID | None, with_ended: bool, page: PageRequest
) -> Page[ShareRead]:
    """Return a page of the links that `actor` may revoke, latest first; those that are over only `with_ended`.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    found = known_shares(actor)
    found = found if with_ended else still_usable(found)
    found = found if mission_id is None else found.where(share.c.mission_id == mission_id)
    rows = await fetch_page(db, found, SHARE_ORDER, page)
    return Page(items=[to_share(row) for row in rows.items], next=rows.next, total=rows.total)


async def revoke_share(db: Connection, actor: Actor, *, share_id: uuid.UUID) -> None:
    """End a link, from the next request on. Nothing happens to one that has been revoked already.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: it is another's, and they may not write to its mission.
    """
    made = to_share(await _row(db, known_shares(actor, Right.read), share_id))
    if made.created_by.id != actor.person_id:
        await require_mission(db, actor, "revoke_share", made.mission.id)
    open_still = (share.c.id == share_id) & share.c.revoked_at.is_(None)
    revoked = await db.execute(update(share).where(open_still).values(revoked_at=func.now()).returning(share.c.id))
    if revoked.first() is not None:
        await record(db, actor, _event("share.revoke", made, after={"prefix": made.prefix}))


async def get_shared(db: Connection, actor: Actor) -> SharedRead:
    """Return what the link shows by which `actor` came.

    Raises:
        NotFound: they came by none.
    """
    row = (await db.execute(shown(actor))).one_or_none()
    if row is None:
        raise NotFound(noun="link", ref="of this request")
    return to_shared(row)


async def note_downloads(db: Connection, actor: Actor, *, files: int, size_bytes: int) -> None:
    """Count files that somebody fetches now, where they came by a link."""
    if actor.share_id is not None:
        await db.execute(count_downloads(actor.share_id, files=files, size_bytes=size_bytes))


async def _row(db: Connection, known: Select[Any], share_id: uuid.UUID) -> Row[Any]:
    row = (await db.execute(known.where(share.c.id == share_id))).one_or_none()
    if row is None:
        raise NotFound(noun="link", ref=str(share_id))
    return row


async def _see_that_it_ends(db: Connection, expires_at: datetime.datetime, *, within_days: int) -> None:
    now = (await db.execute(select(func.now()))).scalar_one()
    if expires_at <= now:
        message = "is in the past; a link must expire later than now"
    elif expires_at > now + datetime.timedelta(days=within_days):
        message = f"is too far off; links of this server are good for {within_days} days at most"
    else:
        return
    raise InvalidRequest(problems=[FieldProblem(field="expires_at", message=message)])


async def _see_that_files_are_there(
    db: Connection, actor: Actor, mission_id: uuid.UUID, file_ids: list[uuid.UUID]
) -> None:
    there = set((await db.execute(files_of(actor, mission_id, file_ids))).scalars())
    for each in file_ids:
        if each not in there:
            raise NotFound(noun="file", ref=str(each))


def _event(operation: str, made: ShareRead, *, after: dict[str, Any]) -> Event:
    place = made.mission
    return Event(operation, "share", made.id, made.name, place.project.id, after=after, mission_id=place.id)
