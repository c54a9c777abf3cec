"""The trash: listing it, restoring from it, and deleting permanently what has been in it for long enough."""

import datetime
import uuid
from collections.abc import Sequence
from typing import Any, NamedTuple

from sqlalchemy import (
    ColumnElement,
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
from kleinkram.contract.projects import TrashRead, TrashResourceType
from kleinkram.contract.uploads import UploadState
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import trashed_files, trashed_missions, trashed_projects
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.files.paths import check_path_free
from kleinkram.server.missions.service import lock_mission
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.quotas import Amount, project_of, require_room, require_room_for_mission
from kleinkram.server.recordings.derive import derive_again
from kleinkram.server.tables import blob, file, mission, person, project, upload

_NAME_RULES = {"uq_project_name_key_live", "uq_mission_name_key_live", "uq_file_path_key_live"}


async def list_trash(
    db: Connection, actor: Actor, *, resource_type: TrashResourceType | None, trash_days: int, page: PageRequest
) -> Page[TrashRead]:
    """Return a page of what was deleted by itself and can still be restored, latest first. Raises InvalidCursor."""
    selects = [*_SELECTS.values()] if resource_type is None else [_SELECTS[resource_type]]
    trashed = union_all(*(select_trashed(actor, trash_days) for select_trashed in selects)).subquery("thing")
    stmt = select(trashed, person.c.name.label("deleted_by_name"))
    stmt = stmt.join_from(trashed, person, person.c.id == trashed.c.deleted_by_id)
    order = Order([trashed.c.deleted_at, trashed.c.resource_type, trashed.c.id], descending=True)

    return await read_page(
        db,
        stmt,
        order,
        page,
        lambda row: TrashRead(
            resource_type=row.resource_type,
            id=row.id,
            name=row.name,
            location=row.location,
            size_bytes=int(row.size_bytes),
            file_count=row.file_count,
            deleted_at=row.deleted_at,
            deleted_by=PersonRef(id=row.deleted_by_id, name=row.deleted_by_name),
            purged_after=row.deleted_at + datetime.timedelta(days=trash_days),
        ),
    )


async def restore(
    db: Connection, actor: Actor, *, resource_type: TrashResourceType, resource_id: uuid.UUID, trash_days: int
) -> None:
    """Restore a deleted thing and everything that was deleted with it.

    Raises NotFound (also if its project or mission is in the trash), NameTaken, QuotaExceeded or PathConflict.
    """
    restore_functions = {
        TrashResourceType.project: _restore_project,
        TrashResourceType.mission: _restore_mission,
        TrashResourceType.file: _restore_file,
    }
    await restore_functions[resource_type](db, actor, resource_id, trash_days)


async def _restore_project(db: Connection, actor: Actor, project_id: uuid.UUID, trash_days: int) -> None:
    stmt = trashed_projects(actor).where(project.c.id == project_id, _is_restorable(project, trash_days))
    stmt = stmt.with_only_columns(project.c.name).with_for_update()
    (name,) = await _get_row(db, stmt, TrashResourceType.project, project_id)
    await _undelete(db, project, project_id, name)
    await audit(db, actor, Event("project.restore", "project", project_id, name, project_id))


async def _restore_mission(db: Connection, actor: Actor, mission_id: uuid.UUID, trash_days: int) -> None:
    await lock_mission(db, mission_id)
    stmt = trashed_missions(actor).where(mission.c.id == mission_id, _is_restorable(mission, trash_days))
    columns = (mission.c.name, mission.c.project_id, project.c.name, project.c.deleted_at)
    stmt = stmt.with_only_columns(*columns, maintain_column_froms=True)
    name, project_id, *parent = await _get_row(db, stmt, TrashResourceType.mission, mission_id)
    _require_parent("project", *parent)
    await require_room_for_mission(db, actor, project_id=project_id, mission_id=mission_id)
    await _undelete(db, mission, mission_id, name)
    await audit(db, actor, Event("mission.restore", "mission", mission_id, name, project_id, mission_id=mission_id))


async def _restore_file(db: Connection, actor: Actor, file_id: uuid.UUID, trash_days: int) -> None:
    parents = (mission.c.name, mission.c.deleted_at, project.c.id, project.c.name, project.c.deleted_at)
    columns = (file.c.path, file.c.mission_id, blob.c.size_bytes, *parents)
    stmt = trashed_files(actor).where(file.c.id == file_id, _is_restorable(file, trash_days))
    stmt = stmt.with_only_columns(*columns, maintain_column_froms=True)
    path, mission_id, size_bytes, *_ = await _get_row(db, stmt, TrashResourceType.file, file_id)
    await lock_mission(db, mission_id)
    project_id = await project_of(db, mission_id)
    await require_room(db, actor, project_id=project_id, requested=Amount(1, size_bytes))
    # Again, now that the mission is locked. `empty_trash` locks no mission for single files, so lock the file too.
    row = await _get_row(db, stmt.with_for_update(of=file), TrashResourceType.file, file_id)
    path, mission_id, _, mission_name, mission_deleted_at, project_id, project_name, project_deleted_at = row
    _require_parent("project", project_name, project_deleted_at)
    _require_parent("mission", mission_name, mission_deleted_at)
    await check_path_free(db, mission_id, path)
    await derive_again(db, mission_id)
    await _undelete(db, file, file_id, path)
    await audit(db, actor, Event("file.restore", "file", file_id, path, project_id, mission_id=mission_id))


async def _get_row(
    db: Connection, stmt: Select[Any], resource_type: TrashResourceType, resource_id: uuid.UUID
) -> tuple[Any, ...]:
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(resource_type=f"{resource_type.value} in the trash", ref=str(resource_id))
    return tuple(row)


def _require_parent(resource_type: str, name: str, deleted_at: datetime.datetime | None) -> None:
    if deleted_at is not None:
        raise NotFound(resource_type=resource_type, ref=f"{name} (it is in the trash too; restore it first)")


async def _undelete(db: Connection, table: Table, row_id: uuid.UUID, name: str) -> None:
    try:
        await db.execute(update(table).where(table.c.id == row_id).values(deleted_at=None, deleted_by_id=None))
    except IntegrityError as error:
        if violated_constraint(error) in _NAME_RULES:
            raise NameTaken(resource_type=table.name, name=name) from error
        raise


def _is_restorable(table: Table, trash_days: int) -> ColumnElement[bool]:
    # What is due may be half deleted already: it cannot be restored any more, whenever `empty_trash` runs.
    return table.c.deleted_at > func.now() - datetime.timedelta(days=trash_days)


def _select_trashed(
    stmt: Select[Any], table: Table, trash_days: int, *columns: ColumnElement[Any], sizes: Select[Any] | None = None
) -> Select[Any]:
    own = (literal(table.name).label("resource_type"), table.c.id, table.c.deleted_at, table.c.deleted_by_id)
    if sizes is not None:
        live = sizes.where(file.c.deleted_at.is_(None)).correlate(table)
        counts = live.with_only_columns(func.count(), maintain_column_froms=True)
        columns += (live.scalar_subquery().label("size_bytes"), counts.scalar_subquery().label("file_count"))
    stmt = stmt.with_only_columns(*own, *columns, maintain_column_froms=True)
    return stmt.where(_is_restorable(table, trash_days))


def _select_projects(actor: Actor, trash_days: int) -> Select[Any]:
    inside = _SIZES.join(mission, mission.c.id == file.c.mission_id)
    sizes = inside.where(mission.c.project_id == project.c.id, mission.c.deleted_at.is_(None))
    columns = (project.c.name.label("name"), literal("").label("location"))
    return _select_trashed(trashed_projects(actor), project, trash_days, *columns, sizes=sizes)


def _select_missions(actor: Actor, trash_days: int) -> Select[Any]:
    sizes = _SIZES.where(file.c.mission_id == mission.c.id)
    columns = (mission.c.name.label("name"), project.c.name.label("location"))
    return _select_trashed(trashed_missions(actor), mission, trash_days, *columns, sizes=sizes)


def _select_files(actor: Actor, trash_days: int) -> Select[Any]:
    location = project.c.name.concat("/").concat(mission.c.name).label("location")
    columns = (file.c.path.label("name"), location, blob.c.size_bytes, literal(1).label("file_count"))
    return _select_trashed(trashed_files(actor), file, trash_days, *columns)


_SIZES = select(func.coalesce(func.sum(blob.c.size_bytes), 0)).join_from(file, blob, blob.c.id == file.c.blob_id)
_SELECTS = {
    TrashResourceType.project: _select_projects,
    TrashResourceType.mission: _select_missions,
    TrashResourceType.file: _select_files,
}


async def empty_trash(db: Connection, *, older_than_days: int, limit: int) -> None:
    """Delete at most `limit` uploads, files, missions and projects each that have been in the trash for so many days.

    A mission is deleted after its files and uploads, a project after its missions; the rest waits for the next round.
    Rows are locked first, so that nobody restores them in the meantime; locked ones are skipped. Objects are deleted
    later by garbage collection.
    """
    before = func.now() - datetime.timedelta(days=older_than_days)
    in_due_mission = (mission.c.deleted_at < before) | (project.c.deleted_at < before)
    await _delete_uploads(db, in_due_mission, limit)
    files = (
        select(file.c.id, file.c.path.label("name"), file.c.mission_id, mission.c.project_id)
        .join_from(file, mission)
        .join(project)
    )
    # A file that was deleted by itself may be in a mission that people use: lock only the file.
    await _delete(db, file, await _lock(db, files.where(file.c.deleted_at < before), limit, file))
    await _delete(db, file, await _lock(db, files.where(in_due_mission), limit, file, mission, project))
    missions = select(mission.c.id, mission.c.name, mission.c.id.label("mission_id"), mission.c.project_id)
    missions = missions.join_from(mission, project)
    # As two conditions: combined, the database would read all files to check a few missions.
    is_empty = and_(
        ~exists().where(file.c.mission_id == mission.c.id), ~exists().where(upload.c.mission_id == mission.c.id)
    )
    rows = await _lock(db, missions.where(in_due_mission, is_empty), limit, mission, project)
    await _delete(db, mission, rows, is_empty)
    no_mission = null().label("mission_id")
    projects = select(project.c.id, project.c.name, no_mission, project.c.id.label("project_id"))
    is_empty = and_(~exists().where(mission.c.project_id == project.c.id))
    rows = await _lock(db, projects.where(project.c.deleted_at < before, is_empty), limit, project)
    await _delete(db, project, rows, is_empty)


async def _delete_uploads(db: Connection, in_due_mission: ColumnElement[bool], limit: int) -> None:
    """Expire the uploads into missions that are due, and delete those that left nothing in the store."""
    columns = (upload.c.id, upload.c.path, upload.c.mission_id, mission.c.project_id)
    uploads = select(*columns).join_from(upload, mission).join(project).where(in_due_mission)
    still_open = uploads.where(upload.c.state == UploadState.open.value)
    ids = [row.id for row in await _lock(db, still_open, limit, upload, mission, project)]
    await db.execute(update(upload).where(upload.c.id.in_(ids)).values(state=UploadState.expired.value))
    cleaned = uploads.where(upload.c.cleaned_at.is_not(None))
    ids = [row.id for row in await _lock(db, cleaned, limit, upload, mission, project)]
    await db.execute(delete(upload).where(upload.c.id.in_(ids)))


class _DueRow(NamedTuple):
    id: uuid.UUID
    name: str
    mission_id: uuid.UUID | None
    project_id: uuid.UUID


async def _lock(db: Connection, due: Select[Any], limit: int, *tables: Table) -> list[_DueRow]:
    # Conditions are checked again once a row is locked: one that was restored in the meantime is left out.
    locked = due.limit(limit).with_for_update(of=tables, key_share=True, skip_locked=True)
    return [_DueRow._make(row) for row in await db.execute(locked)]


async def _delete(db: Connection, table: Table, rows: Sequence[_DueRow], *conditions: ColumnElement[bool]) -> None:
    stmt = delete(table).where(table.c.id.in_([row.id for row in rows]), *conditions).returning(table.c.id)
    deleted = set((await db.execute(stmt)).scalars())
    resource_type = table.name
    events = [
        Event(f"{resource_type}.purge", resource_type, row.id, row.name, row.project_id, mission_id=row.mission_id)
        for row in rows
        if row.id in deleted
    ]
    await audit(db, None, *events)
