"""What is asked of the trash. Functions return selects; they touch no connection."""

import datetime
import uuid
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, Table, func, literal, select, union_all

from kleinkram.contract.people import PersonRef
from kleinkram.contract.trash import TrashNoun, TrashRead
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.visible import trashed_files, trashed_missions, trashed_projects
from kleinkram.server.paging import Order
from kleinkram.server.tables import blob, file, mission, person, project


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
