"""Operations on the viewer's layouts: readers of a project have personal ones, and its writers change the shared ones.

Nobody but its creator sees a personal layout, not even an admin: the audit log says only that there was one.
"""

import uuid
from typing import Any, NamedTuple

from sqlalchemy import Row, Select, and_, delete, func, insert, or_, select, update
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.audit import ChangeKind
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, InvalidRequest, NameTaken, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.viewer_layouts import (
    MAX_VIEWER_LAYOUTS,
    ViewerLayoutCreate,
    ViewerLayoutRead,
    ViewerLayoutUpdate,
)
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.rights import check_credential, require_match, require_project
from kleinkram.server.access.visible import visible_projects
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.change_events import ChangeEvent, publish
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.tables import person, project, viewer_layout

_BY_NAME = Order([viewer_layout.c.name_key, viewer_layout.c.id])
_UNIQUE_NAMES = {"uq_viewer_layout_shared_name", "uq_viewer_layout_personal_name"}
_EDITABLE = ("name", "panels", "is_default")
_CHANGE_KINDS = {
    "project.create_layout": ChangeKind.created,
    "project.update_layout": ChangeKind.changed,
    "project.delete_layout": ChangeKind.removed,
}


class LayoutPlace(NamedTuple):
    """The ids of a layout and of its project."""

    project_id: uuid.UUID
    layout_id: uuid.UUID


async def list_layouts(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, page: PageRequest
) -> Page[ViewerLayoutRead]:
    """Return a page of the shared layouts of a project and of the actor's own. Raises NotFound or InvalidCursor."""
    await require_project(db, actor, "list_viewer_layouts", project_id)
    return await read_page(db, _visible_layouts(actor, project_id), _BY_NAME, page, lambda row: _to_layout(row, actor))


async def create_layout(
    db: Connection, actor: Actor, *, project_id: uuid.UUID, new_layout: ViewerLayoutCreate
) -> ViewerLayoutRead:
    """Add a layout to a project and return it.

    Raises:
        NotFound: the project does not exist, or is not visible.
        Forbidden: the actor may not share layouts in it.
        NameTaken: the project has a shared layout of the name, or the actor a personal one.
        InvalidRequest: there are very many of them.
    """
    await _lock_project(db, actor, project_id)
    await require_project(db, actor, "create_viewer_layout", project_id)
    if new_layout.is_shared:
        check_credential(actor, "share_viewer_layout")
        await require_project(db, actor, "share_viewer_layout", project_id)
    await _require_room(db, actor, project_id, is_shared=new_layout.is_shared)
    place = LayoutPlace(project_id, uuid.uuid4())
    values = {**new_layout.model_dump(), "name_key": name_key(new_layout.name), "created_by_id": actor.person_id}
    try:
        await db.execute(insert(viewer_layout).values(id=place.layout_id, project_id=project_id, **values))
    except IntegrityError as error:
        raise _name_taken(error, new_layout.name) from error
    created = await _get_layout(db, actor, place)
    await _record(db, actor, "project.create_layout", created, after=_plain(created))
    return created


async def update_layout(
    db: Connection, actor: Actor, *, place: LayoutPlace, changes: ViewerLayoutUpdate, if_match: str | None = None
) -> ViewerLayoutRead:
    """Change a layout and return it; its ETag is not checked where nothing changes.

    Raises:
        NotFound: it does not exist, or is not visible.
        Forbidden: the actor may not change it.
        InvalidRequest: a personal one would become the default.
        NameTaken: another one has the name.
        EditConflict: its ETag is not the one in `if_match`.
    """
    old = await _get_changeable(db, actor, place, "update_viewer_layout")
    requested = changes.model_dump(exclude_none=True)
    values = {name: value for name, value in requested.items() if value != getattr(old, name)}
    if not values:
        return old
    require_match(if_match, old.etag, resource_type="layout", name=old.name)
    if "is_default" in values:
        await _end_default(db, old)
    if "name" in values:
        values["name_key"] = name_key(values["name"])
    try:
        await db.execute(update(viewer_layout).where(viewer_layout.c.id == old.id).values(**values))
    except IntegrityError as error:
        raise _name_taken(error, changes.name or old.name) from error
    new = await _get_layout(db, actor, place)
    differing = [name for name in _EDITABLE if getattr(old, name) != getattr(new, name)]
    before, after = ({name: getattr(version, name) for name in differing} for version in (old, new))
    await _record(db, actor, "project.update_layout", new, {"layout": old.name, **before}, after)
    return new


async def delete_layout(db: Connection, actor: Actor, *, place: LayoutPlace) -> None:
    """Delete a layout. Raises NotFound or Forbidden."""
    old = await _get_changeable(db, actor, place, "delete_viewer_layout")
    await db.execute(delete(viewer_layout).where(viewer_layout.c.id == old.id))
    await _record(db, actor, "project.delete_layout", old, _plain(old))


def _visible_layouts(actor: Actor, project_id: uuid.UUID) -> Select[Any]:
    projects = visible_projects(actor).with_only_columns(project.c.id).where(project.c.id == project_id)
    return (
        select(viewer_layout, person.c.name.label("created_by_name"))
        .join(person, person.c.id == viewer_layout.c.created_by_id)
        .where(viewer_layout.c.project_id.in_(projects))
        .where(or_(viewer_layout.c.is_shared, viewer_layout.c.created_by_id == actor.person_id))
    )


def _to_layout(row: Row[Any], actor: Actor) -> ViewerLayoutRead:
    is_person = actor.kind is ActorKind.person
    created_by = {"id": row.created_by_id, "name": row.created_by_name} if is_person else None
    return ViewerLayoutRead.model_validate({**row._mapping, "created_by": created_by})


async def _get_layout(db: Connection, actor: Actor, place: LayoutPlace) -> ViewerLayoutRead:
    stmt = _visible_layouts(actor, place.project_id).where(viewer_layout.c.id == place.layout_id)
    row = (await db.execute(stmt)).one_or_none()
    if row is None:
        raise NotFound(resource_type="layout", ref=str(place.layout_id))
    return _to_layout(row, actor)


async def _get_changeable(db: Connection, actor: Actor, place: LayoutPlace, operation: str) -> ViewerLayoutRead:
    """Lock a layout's project, and return the layout if the actor may change it. Raises NotFound or Forbidden."""
    await _lock_project(db, actor, place.project_id)
    layout = await _get_layout(db, actor, place)
    await require_project(db, actor, _required(layout, operation), place.project_id)
    return layout


def _required(layout: ViewerLayoutRead, operation: str) -> str:
    """Return the operation whose right is required: that of creating layouts suffices for one's own."""
    return operation if layout.is_shared else "create_viewer_layout"


async def _lock_project(db: Connection, actor: Actor, project_id: uuid.UUID) -> None:
    """Lock a visible project, so that its layouts are changed one after the other."""
    stmt = visible_projects(actor).with_only_columns(project.c.id).where(project.c.id == project_id)
    await db.execute(stmt.with_for_update(key_share=True))


async def _require_room(db: Connection, actor: Actor, project_id: uuid.UUID, *, is_shared: bool) -> None:
    own = and_(~viewer_layout.c.is_shared, viewer_layout.c.created_by_id == actor.person_id)
    alike = viewer_layout.c.is_shared if is_shared else own
    stmt = select(func.count()).where(viewer_layout.c.project_id == project_id, alike)
    if (await db.execute(stmt)).scalar_one() >= MAX_VIEWER_LAYOUTS:
        kind = "shared" if is_shared else "personal"
        raise _invalid("name", f"you may have at most {MAX_VIEWER_LAYOUTS} {kind} layouts in a project; delete one")


async def _end_default(db: Connection, layout: ViewerLayoutRead) -> None:
    """Make no layout of a project its default, before another one becomes it."""
    if not layout.is_shared:
        raise _invalid("is_default", "a personal layout cannot be the default of a project")
    is_default = (viewer_layout.c.project_id == layout.project_id, viewer_layout.c.is_default)
    await db.execute(update(viewer_layout).where(*is_default).values(is_default=False))


def _plain(layout: ViewerLayoutRead) -> Metadata:
    """Return the fields of a layout for the audit log."""
    return {"layout": layout.name, "panels": [*layout.panels], "is_default": layout.is_default}


async def _record(
    db: Connection,
    actor: Actor,
    operation: str,
    layout: ViewerLayoutRead,
    before: Metadata | None = None,
    after: Metadata | None = None,
) -> None:
    """Write a change of a layout to the audit log of its project, and tell open pages of it."""
    if not layout.is_shared:
        before, after = None, {"is_personal": True}
    name: str = (await db.execute(select(project.c.name).where(project.c.id == layout.project_id))).scalar_one()
    takes = _required(layout, "share_viewer_layout")
    place = (layout.project_id, name, layout.project_id)
    await audit(db, actor, Event(operation, "project", *place, before or {}, after or {}, takes=takes))
    readers = {"project_id": layout.project_id} if layout.is_shared else {"by_id": actor.person_id}
    await publish(db, [ChangeEvent("viewer_layout", _CHANGE_KINDS[operation], layout.id, **readers)])


def _name_taken(error: IntegrityError, name: str) -> Exception:
    is_name = violated_constraint(error) in _UNIQUE_NAMES
    return NameTaken(resource_type="layout", name=name) if is_name else error


def _invalid(field: str, message: str) -> InvalidRequest:
    return InvalidRequest(problems=[FieldProblem(field=field, message=message)])
