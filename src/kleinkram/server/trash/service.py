"""What may be done with the trash: look, and put things back. What empties it is a job (`blobs`)."""

import datetime
import uuid
from typing import Any

from sqlalchemy import Row, Select, Table, update
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.errors import NameTaken, NotFound
from kleinkram.contract.paging import Page
from kleinkram.contract.trash import TrashNoun, TrashRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.missions.service import lock_mission
from kleinkram.server.paging import PageRequest, fetch_page
from kleinkram.server.quotas.service import Amount, project_of, require_room, require_room_for_mission
from kleinkram.server.recordings.service import regroup
from kleinkram.server.tables import file, mission, project
from kleinkram.server.trash import queries

_NAME_RULES = {"uq_project_name_key_live", "uq_mission_name_key_live", "uq_file_path_key_live"}


async def list_trash(
    db: Connection, actor: Actor, *, noun: TrashNoun | None, trash_days: int, page: PageRequest
) -> Page[TrashRead]:
    """Return a page of what was deleted by itself and can still be had back, latest first.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    statement, order = queries.in_trash(actor, noun=noun, trash_days=trash_days)
    rows = await fetch_page(db, statement, order, page)
    kept = datetime.timedelta(days=trash_days)
    return Page(items=[queries.to_trash(row, kept=kept) for row in rows.items], next=rows.next, total=rows.total)


async def restore(db: Connection, actor: Actor, *, noun: TrashNoun, noun_id: uuid.UUID, trash_days: int) -> None:
    """Put a deleted thing back where it was, with all that went with it.

    Raises:
        NotFound: it is not in the trash, was there too long, or what held it is in the trash itself.
        NameTaken: something else has its name by now.
        QuotaExceeded: its project has no room for it any more.
        PathConflict: a file's path is a folder by now, or needs a folder where a file is.
    """
    put_back = {
        TrashNoun.project: _restore_project,
        TrashNoun.mission: _restore_mission,
        TrashNoun.file: _restore_file,
    }
    await put_back[noun](db, actor, noun_id, trash_days)


async def _restore_project(db: Connection, actor: Actor, project_id: uuid.UUID, trash_days: int) -> None:
    found = queries.trashed_project(actor, project_id, trash_days=trash_days)
    row = await _found(db, found, TrashNoun.project, project_id)
    await _undelete(db, project, row, name=row.name)
    await record(db, actor, Event("project.restore", "project", project_id, row.name, project_id))


async def _restore_mission(db: Connection, actor: Actor, mission_id: uuid.UUID, trash_days: int) -> None:
    await lock_mission(db, mission_id)
    found = queries.trashed_mission(actor, mission_id, trash_days=trash_days)
    row = await _found(db, found, TrashNoun.mission, mission_id)
    _refuse_without_parent("project", row.project_name, row.project_deleted_at)
    await require_room_for_mission(db, actor, project_id=row.project_id, mission_id=mission_id)
    await _undelete(db, mission, row, name=row.name)
    event = Event("mission.restore", "mission", mission_id, row.name, row.project_id, mission_id=mission_id)
    await record(db, actor, event)


async def _restore_file(db: Connection, actor: Actor, file_id: uuid.UUID, trash_days: int) -> None:
    found = queries.trashed_file(actor, file_id, trash_days=trash_days)
    row = await _found(db, found, TrashNoun.file, file_id)
    await lock_mission(db, row.mission_id)
    project_id = await project_of(db, row.mission_id)
    await require_room(db, actor, project_id=project_id, asked=Amount(1, row.size_bytes))
    # Once more, now that its mission is held; the sweep of single files holds no mission, so the file is locked too.
    row = await _found(db, found.with_for_update(of=file), TrashNoun.file, file_id)
    _refuse_without_parent("project", row.project_name, row.project_deleted_at)
    _refuse_without_parent("mission", row.mission_name, row.mission_deleted_at)
    await check_path_free(db, row.mission_id, row.path)
    await regroup(db, row.mission_id)
    await _undelete(db, file, row, name=row.path)
    event = Event("file.restore", "file", file_id, row.path, row.project_id, mission_id=row.mission_id)
    await record(db, actor, event)


async def _found(db: Connection, statement: Select[Any], noun: TrashNoun, noun_id: uuid.UUID) -> Row[Any]:
    row = (await db.execute(statement)).one_or_none()
    if row is None:
        raise NotFound(noun=f"{noun.value} in the trash", ref=str(noun_id))
    return row


def _refuse_without_parent(noun: str, name: str, deleted_at: datetime.datetime | None) -> None:
    if deleted_at is not None:
        raise NotFound(noun=noun, ref=f"{name} (it is in the trash too; restore it first)")


async def _undelete(db: Connection, table: Table, row: Row[Any], *, name: str) -> None:
    try:
        await db.execute(update(table).where(table.c.id == row.id).values(deleted_at=None, deleted_by_id=None))
    except IntegrityError as error:
        if violated_constraint(error) in _NAME_RULES:
            raise NameTaken(noun=table.name, name=name) from error
        raise
