"""What may be done with links. Their secrets leave the server once, in the answer that makes them."""

import datetime
import uuid
from typing import Any

from sqlalchemy import Row, Select, func, insert, select, update

from kleinkram.contract.errors import FieldProblem, InvalidRequest, NotFound
from kleinkram.contract.paging import Page
from kleinkram.contract.rights import Right
from kleinkram.contract.secrets import SecretKind
from kleinkram.contract.shares import SHARE_PAGE, ShareCreate, SharedRead, ShareMade, ShareRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import ensure_active_person, require_mission
from kleinkram.server.access.secrets import new_secret
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection
from kleinkram.server.missions.service import lock_mission
from kleinkram.server.paging import PageRequest, fetch_page
from kleinkram.server.settings import Settings
from kleinkram.server.shares import queries
from kleinkram.server.tables import share, share_file


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
    made = queries.to_share(await _row(db, queries.known_shares(actor), share_id))
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
    found = queries.known_shares(actor)
    found = found if with_ended else queries.still_usable(found)
    found = found if mission_id is None else found.where(share.c.mission_id == mission_id)
    rows = await fetch_page(db, found, queries.SHARE_ORDER, page)
    return Page(items=[queries.to_share(row) for row in rows.items], next=rows.next, total=rows.total)


async def revoke_share(db: Connection, actor: Actor, *, share_id: uuid.UUID) -> None:
    """End a link, from the next request on. Nothing happens to one that has been revoked already.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: it is another's, and they may not write to its mission.
    """
    made = queries.to_share(await _row(db, queries.known_shares(actor, Right.read), share_id))
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
    row = (await db.execute(queries.shown(actor))).one_or_none()
    if row is None:
        raise NotFound(noun="link", ref="of this request")
    return queries.to_shared(row)


async def note_downloads(db: Connection, actor: Actor, *, files: int, size_bytes: int) -> None:
    """Count files that somebody fetches now, where they came by a link."""
    if actor.share_id is not None:
        await db.execute(queries.count_downloads(actor.share_id, files=files, size_bytes=size_bytes))


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
    there = set((await db.execute(queries.files_of(actor, mission_id, file_ids))).scalars())
    for each in file_ids:
        if each not in there:
            raise NotFound(noun="file", ref=str(each))


def _event(operation: str, made: ShareRead, *, after: dict[str, Any]) -> Event:
    place = made.mission
    return Event(operation, "share", made.id, made.name, place.project.id, after=after, mission_id=place.id)
