"""Emptying the trash: the rows of what was deleted long enough ago. Objects follow by the sweep, never from here."""

import datetime
import uuid
from collections.abc import Collection

from sqlalchemy import Select, delete, func, select, update

from kleinkram.contract.uploads import UploadState
from kleinkram.server.audit.service import Event, record_all
from kleinkram.server.db import Connection
from kleinkram.server.tables import file, mission, project, upload


async def empty_trash(db: Connection, *, older_than_days: int, limit: int) -> None:
    """Drop at most `limit` files, missions and projects each that have been in the trash for so many days.

    A mission goes when its files and uploads are gone, a project when its missions are; what is left waits for the
    next round, so one round is never long.
    """
    before = func.now() - datetime.timedelta(days=older_than_days)
    await _end_uploads(db, before_missions=_expired_missions(before))
    files = select(file.c.id, file.c.path).where(
        (file.c.deleted_at < before) | file.c.mission_id.in_(_expired_missions(before))
    )
    rows = (await db.execute(files.limit(limit).with_for_update(skip_locked=True))).all()
    await db.execute(delete(file).where(file.c.id.in_([row.id for row in rows])))
    await _record(db, "file", {row.id: row.path for row in rows})
    await _drop_missions(db, _expired_missions(before), limit)
    await _drop_projects(db, before, limit)


def _expired_missions(before: object) -> Select[tuple[uuid.UUID]]:
    gone_with_project = select(project.c.id).where(project.c.deleted_at < before)
    return select(mission.c.id).where((mission.c.deleted_at < before) | mission.c.project_id.in_(gone_with_project))


async def _end_uploads(db: Connection, *, before_missions: Select[tuple[uuid.UUID]]) -> None:
    open_ones = upload.c.mission_id.in_(before_missions) & (upload.c.state == UploadState.open.value)
    await db.execute(update(upload).where(open_ones).values(state=UploadState.expired.value))
    cleaned = upload.c.mission_id.in_(before_missions) & upload.c.cleaned_at.is_not(None)
    await db.execute(delete(upload).where(cleaned))


async def _drop_missions(db: Connection, expired: Select[tuple[uuid.UUID]], limit: int) -> None:
    held = (
        select(file.c.id).where(file.c.mission_id == mission.c.id).exists()
        | select(upload.c.id).where(upload.c.mission_id == mission.c.id).exists()
    )
    statement = select(mission.c.id, mission.c.name).where(mission.c.id.in_(expired), ~held).limit(limit)
    rows = (await db.execute(statement)).all()
    await db.execute(delete(mission).where(mission.c.id.in_([row.id for row in rows])))
    await _record(db, "mission", {row.id: row.name for row in rows})


async def _drop_projects(db: Connection, before: object, limit: int) -> None:
    held = select(mission.c.id).where(mission.c.project_id == project.c.id).exists()
    statement = select(project.c.id, project.c.name).where(project.c.deleted_at < before, ~held).limit(limit)
    rows = (await db.execute(statement)).all()
    await db.execute(delete(project).where(project.c.id.in_([row.id for row in rows])))
    await _record(db, "project", {row.id: row.name for row in rows})


async def _record(db: Connection, noun: str, swept: dict[uuid.UUID, str]) -> None:
    events: Collection[Event] = [Event(f"{noun}.sweep", noun, each, name, None) for each, name in swept.items()]
    await record_all(db, None, list(events))
