"""What is asked of the trash. Functions return selects; they touch no connection."""

import datetime
import uuid
from collections.abc import Sequence
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Row,
    Select,
    Table,
    and_,
    delete,
    exists,
    func,
    literal,
    null,
    select,
    union_all,
    update,
)
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.base import Page
from kleinkram.contract.errors import NameTaken, NotFound
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import TrashNoun, TrashRead
from kleinkram.contract.uploads import UploadState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import trashed_files, trashed_missions, trashed_projects
from kleinkram.server.audit.service import Event, record, record_all
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.missions.service import lock_mission
from kleinkram.server.paging import Order, PageRequest, fetch_page
from kleinkram.server.quotas import Amount, project_of, require_room, require_room_for_mission
from kleinkram.server.recordings.service import regroup
from kleinkram.server.tables import blob, file, mission, person, project, upload


def _project_amounts() -> tuple[ColumnElement[Any], ColumnElement[Any]]:
    held = select(func.coalesce(func.sum(blob.c.size_bytes), 0)).join_from(file, blob, blob.c.id == file.c.blob_id)
    inside = held.join(mission, mission.c.id == file.c.mission_id).where(
        mission.c.project_id == project.c.id, mission.c.deleted_at.is_(None), file.c.deleted_at.is_(None)
    )
    return _sized(inside.correlate(project))


def _mission_amounts() -> tuple[ColumnElement[Any], ColumnElement[Any]]:
    held = select(func.coalesce(func.sum(blob.c.size_bytes), 0)).join_from(file, blob, blob.c.id == file.c.blob_id)
    inside = held.where(file.c.mission_id == mission.c.id, file.c.deleted_at.is_(None))
    return _sized(inside.correlate(mission))


def _sized(sizes: Select[Any]) -> tuple[ColumnElement[Any], ColumnElement[Any]]:
    counts = sizes.with_only_columns(func.count(), maintain_column_froms=True)
    return sizes.scalar_subquery().label("size_bytes"), counts.scalar_subquery().label("file_count")


def _restorable(table: Table, trash_days: int) -> ColumnElement[bool]:
    # What is due to be swept may be half gone already: it is out of reach from that moment, whenever the sweep comes.
    return table.c.deleted_at > func.now() - datetime.timedelta(days=trash_days)


def _arms(actor: Actor, trash_days: int) -> dict[TrashNoun, Select[Any]]:
    def rows(stmt: Select[Any], noun: TrashNoun, table: Table, *columns: ColumnElement[Any]) -> Select[Any]:
        own = (literal(noun.value).label("noun"), table.c.id, table.c.deleted_at, table.c.deleted_by_id)
        chosen = stmt.with_only_columns(*own, *columns, maintain_column_froms=True)
        return chosen.where(_restorable(table, trash_days))

    place = project.c.name.concat("/").concat(mission.c.name)
    return {
        TrashNoun.project: rows(
            trashed_projects(actor),
            TrashNoun.project,
            project,
            project.c.name.label("name"),
            literal("").label("place"),
            *_project_amounts(),
        ),
        TrashNoun.mission: rows(
            trashed_missions(actor),
            TrashNoun.mission,
            mission,
            mission.c.name.label("name"),
            project.c.name.label("place"),
            *_mission_amounts(),
        ),
        TrashNoun.file: rows(
            trashed_files(actor),
            TrashNoun.file,
            file,
            file.c.path.label("name"),
            place.label("place"),
            blob.c.size_bytes,
            literal(1).label("file_count"),
        ),
    }


def in_trash(actor: Actor, *, noun: TrashNoun | None, trash_days: int) -> tuple[Select[Any], Order]:
    """Return what can be had back from the trash, of one noun or of all, and its order: latest first."""
    arms = _arms(actor, trash_days)
    things = union_all(*(arms.values() if noun is None else [arms[noun]])).subquery("thing")
    named = select(things, person.c.name.label("deleted_by_name"))
    stmt = named.join_from(things, person, person.c.id == things.c.deleted_by_id)
    return stmt, Order([things.c.deleted_at, things.c.noun, things.c.id], descending=True)


def to_trash(row: Row[Any], *, kept: datetime.timedelta) -> TrashRead:
    """Return the thing that a row stands for; `kept` is how long the trash keeps things."""
    return TrashRead(
        noun=row.noun,
        id=row.id,
        name=row.name,
        place=row.place,
        size_bytes=int(row.size_bytes),
        file_count=row.file_count,
        deleted_at=row.deleted_at,
        deleted_by=PersonRef(id=row.deleted_by_id, name=row.deleted_by_name),
        swept_after=row.deleted_at + kept,
    )


def trashed_project(actor: Actor, project_id: uuid.UUID, *, trash_days: int) -> Select[Any]:
    """Return a project that can be had back from the trash, locked."""
    found = trashed_projects(actor).where(project.c.id == project_id, _restorable(project, trash_days))
    return found.with_for_update()


def trashed_mission(actor: Actor, mission_id: uuid.UUID, *, trash_days: int) -> Select[Any]:
    """Return a mission that can be had back, with its project's name and whether that is in the trash too."""
    parent = (project.c.name.label("project_name"), project.c.deleted_at.label("project_deleted_at"))
    found = trashed_missions(actor).where(mission.c.id == mission_id, _restorable(mission, trash_days))
    return found.add_columns(*parent)


def trashed_file(actor: Actor, file_id: uuid.UUID, *, trash_days: int) -> Select[Any]:
    """Return a file that can be had back, with what holds it and whether that is in the trash too."""
    parents = (
        mission.c.name.label("mission_name"),
        mission.c.deleted_at.label("mission_deleted_at"),
        mission.c.project_id,
        blob.c.size_bytes,
        project.c.name.label("project_name"),
        project.c.deleted_at.label("project_deleted_at"),
    )
    found = trashed_files(actor).where(file.c.id == file_id, _restorable(file, trash_days))
    return found.add_columns(*parents)


_NAME_RULES = {"uq_project_name_key_live", "uq_mission_name_key_live", "uq_file_path_key_live"}


async def list_trash(
    db: Connection, actor: Actor, *, noun: TrashNoun | None, trash_days: int, page: PageRequest
) -> Page[TrashRead]:
    """Return a page of what was deleted by itself and can still be had back, latest first.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    statement, order = in_trash(actor, noun=noun, trash_days=trash_days)
    rows = await fetch_page(db, statement, order, page)
    kept = datetime.timedelta(days=trash_days)
    return Page(items=[to_trash(row, kept=kept) for row in rows.items], next=rows.next, total=rows.total)


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
    found = trashed_project(actor, project_id, trash_days=trash_days)
    row = await _found(db, found, TrashNoun.project, project_id)
    await _undelete(db, project, row, name=row.name)
    await record(db, actor, Event("project.restore", "project", project_id, row.name, project_id))


async def _restore_mission(db: Connection, actor: Actor, mission_id: uuid.UUID, trash_days: int) -> None:
    await lock_mission(db, mission_id)
    found = trashed_mission(actor, mission_id, trash_days=trash_days)
    row = await _found(db, found, TrashNoun.mission, mission_id)
    _refuse_without_parent("project", row.project_name, row.project_deleted_at)
    await require_room_for_mission(db, actor, project_id=row.project_id, mission_id=mission_id)
    await _undelete(db, mission, row, name=row.name)
    event = Event("mission.restore", "mission", mission_id, row.name, row.project_id, mission_id=mission_id)
    await record(db, actor, event)


async def _restore_file(db: Connection, actor: Actor, file_id: uuid.UUID, trash_days: int) -> None:
    found = trashed_file(actor, file_id, trash_days=trash_days)
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
        Event(f"{noun}.sweep", noun, row.id, row.name, row.project_id, mission_id=row.mission_id)
        for row in rows
        if row.id in gone
    ]
    await record_all(db, None, events)
