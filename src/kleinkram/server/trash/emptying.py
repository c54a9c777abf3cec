"""Emptying the trash: the rows of what was deleted long enough ago. Objects follow by the sweep, never from here.

Whatever is dropped is locked first, with what holds it, and by that seen to be still due: nobody restores it meanwhile.
What somebody else holds is passed over until the next round; the sweep never waits for a person, nor a person long.
"""

import datetime
from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, Table, and_, delete, exists, func, null, select, update

from kleinkram.contract.uploads import UploadState
from kleinkram.server.audit.service import Event, record_all
from kleinkram.server.db import Connection
from kleinkram.server.tables import file, mission, project, upload


async def empty_trash(db: Connection, *, older_than_days: int, limit: int) -> None:
    """Drop at most `limit` uploads, files, missions and projects each, of what has been in the trash for so many days.

    A mission goes when its files and uploads are gone, a project when its missions are; what is left waits for the
    next round, so one round is never long.
    """
    before = func.now() - datetime.timedelta(days=older_than_days)
    in_due_mission = (mission.c.deleted_at < before) | (project.c.deleted_at < before)
    await _drop_uploads(db, in_due_mission, limit)
    files = (
        select(file.c.id, file.c.path.label("name"), file.c.mission_id, mission.c.project_id)
        .join_from(file, mission)
        .join(project)
    )
    # A file deleted by itself may lie in a mission where people are at work: then only the file is held.
    await _drop(db, file, await _locked(db, files.where(file.c.deleted_at < before), limit, file))
    await _drop(db, file, await _locked(db, files.where(in_due_mission), limit, file, mission, project))
    missions = select(mission.c.id, mission.c.name, mission.c.id.label("mission_id"), mission.c.project_id).join_from(
        mission, project
    )
    # Each said by itself: taken together, the database would read all files to look at a few missions.
    empty = and_(~_any(file.c.mission_id == mission.c.id), ~_any(upload.c.mission_id == mission.c.id))
    rows = await _locked(db, missions.where(in_due_mission, empty), limit, mission, project)
    await _drop(db, mission, rows, empty)
    nowhere = null().label("mission_id")
    projects = select(project.c.id, project.c.name, nowhere, project.c.id.label("project_id"))
    empty = ~_any(mission.c.project_id == project.c.id)
    await _drop(
        db, project, await _locked(db, projects.where(project.c.deleted_at < before, empty), limit, project), empty
    )


async def _drop_uploads(db: Connection, in_due_mission: ColumnElement[bool], limit: int) -> None:
    """End uploads of missions that go, and drop those that left nothing at the store any more."""
    uploads = select(upload.c.id).join_from(upload, mission).join(project).where(in_due_mission)
    still_open = uploads.where(upload.c.state == UploadState.open.value)
    ids = [row.id for row in await _locked(db, still_open, limit, upload, mission, project)]
    await db.execute(update(upload).where(upload.c.id.in_(ids)).values(state=UploadState.expired.value))
    cleaned = uploads.where(upload.c.cleaned_at.is_not(None))
    ids = [row.id for row in await _locked(db, cleaned, limit, upload, mission, project)]
    await db.execute(delete(upload).where(upload.c.id.in_(ids)))


def _any(condition: ColumnElement[bool]) -> ColumnElement[bool]:
    return exists().where(condition)


async def _locked(db: Connection, due: Select[Any], limit: int, *tables: Table) -> Sequence[Row[Any]]:
    # What is locked is judged again as it is then: a row that was restored since the statement began is left out.
    return (await db.execute(due.limit(limit).with_for_update(of=tables, key_share=True, skip_locked=True))).all()


async def _drop(db: Connection, table: Table, rows: Sequence[Row[Any]], *still: ColumnElement[bool]) -> None:
    statement = delete(table).where(table.c.id.in_([row.id for row in rows]), *still).returning(table.c.id)
    gone = set((await db.execute(statement)).scalars())
    noun = table.name
    events = [
        Event(f"{noun}.purge", noun, row.id, row.name, row.project_id, mission_id=row.mission_id)
        for row in rows
        if row.id in gone
    ]
    await record_all(db, None, events)
