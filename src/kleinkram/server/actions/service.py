"""Operations on actions. Versions are immutable."""

import hashlib
import json
import uuid
from typing import Any

from sqlalchemy import Row, func, insert, select, update
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.actions import (
    ActionCreate,
    ActionDefinition,
    ActionFilter,
    ActionRead,
    ActionVersionRead,
)
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, Forbidden, InvalidRequest, NameTaken, NotFound
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.server.access.actor import Actor
from kleinkram.server.access.rights import require_creator, require_match, require_project
from kleinkram.server.actions import queries
from kleinkram.server.audit.service import Event, record
from kleinkram.server.db import Connection, violated_constraint
from kleinkram.server.pagination import PageRequest, fetch_page
from kleinkram.server.settings import Creators
from kleinkram.server.tables import action, action_version


async def list_actions(db: Connection, actor: Actor, *, matching: ActionFilter, page: PageRequest) -> Page[ActionRead]:
    """Return a page of the actions that match, by name.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    row = queries.action_rows(actor, queries.narrow(queries.visible_actions(actor), matching))
    rows = await fetch_page(db, row, queries.ACTION_ORDER, page)
    return Page(items=[queries.to_action(row) for row in rows.items], next=rows.next, total=rows.total)


async def get_action(db: Connection, actor: Actor, action_id: uuid.UUID) -> ActionRead:
    """Return one action.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    return queries.to_action(await _row(db, actor, action_id))


async def create_action(db: Connection, actor: Actor, *, requested: ActionCreate, creators: Creators) -> ActionRead:
    """Publish the first version of an action and return the action.

    Raises:
        NotFound: the project is not there, or not for this actor.
        Forbidden: this actor may not publish there; for the whole lab, the settings reserve that to others.
        NameTaken: an action of this name exists.
    """
    by_power = False
    if requested.project_id is None:
        by_power = await require_creator(db, actor, creators, noun="action")
    else:
        await require_project(db, actor, "create_action", requested.project_id)
    action_id, name = uuid.uuid4(), requested.definition.name
    values = {"project_id": requested.project_id, "name": name, "name_key": name_key(name)}
    try:
        await db.execute(insert(action).values(id=action_id, created_by_id=actor.person_id, **values))
    except IntegrityError as error:
        if violated_constraint(error) != "uq_action_name_key_live":
            raise
        raise NameTaken(noun="action", name=name) from error
    await _add_version(db, actor, action_id, 1, requested.definition)
    made = await get_action(db, actor, action_id)
    await record(db, actor, _event("action.create", made, by_power=by_power))
    return made


async def add_version(
    db: Connection, actor: Actor, *, action_id: uuid.UUID, definition: ActionDefinition, if_match: str | None = None
) -> ActionRead:
    """Publish a further version of an action and return the action; unchanged where it equals the latest version.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: this actor may not change it.
        InvalidRequest: it has another name.
        EditConflict: its ETag is no longer `if_match`: another person published a version, or archived it.
    """
    old = await _changeable(db, actor, action_id)
    if name_key(definition.name) != name_key(old.name):
        message = f"is {definition.name!r}, but this action is called {old.name!r}; publish it as another action"
        raise InvalidRequest(problems=[FieldProblem(field="definition.name", message=message)])
    if definition == old.latest.definition:
        return old
    require_match(if_match, old.etag, noun="action", name=old.name)
    await _add_version(db, actor, action_id, old.latest.number + 1, definition)
    made = await get_action(db, actor, action_id)
    await record(db, actor, _event("action.publish", made))
    return made


async def set_archived(
    db: Connection, actor: Actor, *, action_id: uuid.UUID, archived: bool, if_match: str | None = None
) -> ActionRead:
    """Archive or restore an action; where nothing changes, its ETag is not checked.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: this actor may not change it.
        NameTaken: another action has its name.
        EditConflict: its ETag is no longer `if_match`.
    """
    old = await _changeable(db, actor, action_id)
    if old.archived is archived:
        return old
    require_match(if_match, old.etag, noun="action", name=old.name)
    values = {"archived_at": func.now() if archived else None}
    try:
        await db.execute(update(action).where(action.c.id == action_id).values(**values))
    except IntegrityError as error:
        raise NameTaken(noun="action", name=old.name) from error
    made = await get_action(db, actor, action_id)
    await record(db, actor, _event("action.archive" if archived else "action.restore", made))
    return made


async def list_versions(
    db: Connection, actor: Actor, *, action_id: uuid.UUID, page: PageRequest
) -> Page[ActionVersionRead]:
    """Return a page of an action's versions, latest first.

    Raises:
        NotFound: it is not there, or not for this actor.
        InvalidCursor: the cursor is not of this list.
    """
    await _row(db, actor, action_id)
    rows = await fetch_page(db, queries.versions_of(action_id), queries.VERSION_ORDER, page)
    return Page(items=[queries.to_version(row) for row in rows.items], next=rows.next, total=rows.total)


async def get_version(db: Connection, actor: Actor, *, action_id: uuid.UUID, number: int | None) -> ActionVersionRead:
    """Return a version of an action that may be run; by default the latest.

    Raises:
        NotFound: the action, or that version, is not there, or not for this actor.
        InvalidRequest: it is archived.
    """
    row = await _row(db, actor, action_id)
    if row.archived_at is not None:
        problem = FieldProblem(field="action_id", message=f"{row.name} is archived; restore it, or choose another")
        raise InvalidRequest(problems=[problem])
    if number is None:
        return queries.to_version(row)
    stmt = queries.versions_of(action_id).where(action_version.c.number == number)
    version = (await db.execute(stmt)).one_or_none()
    if version is None:
        raise NotFound(noun="version", ref=f"{row.name}@{number}")
    return queries.to_version(version)


async def store_unpublished(db: Connection, actor: Actor, definition: ActionDefinition) -> tuple[uuid.UUID, str | None]:
    """Store a definition that is not published, once; return the id of its version, and the digest of its image."""
    values = _stored(definition)
    stmt = upsert(action_version).values(id=uuid.uuid4(), created_by_id=actor.person_id, **values)
    await db.execute(stmt.on_conflict_do_nothing())
    same = (action_version.c.definition_sha256 == values["definition_sha256"]) & action_version.c.action_id.is_(None)
    row = (await db.execute(select(action_version.c.id, action_version.c.image_digest).where(same))).one()
    return row.id, row.image_digest


async def _changeable(db: Connection, actor: Actor, action_id: uuid.UUID) -> ActionRead:
    locked = select(action.c.id).where(action.c.id == action_id).with_for_update()
    await db.execute(locked)
    row = await get_action(db, actor, action_id)
    if not row.may_change:
        needs = "WRITE on its project" if row.project else "admin rights, or to be the person who created it"
        raise Forbidden(noun="action", operation="change the action", needs=needs)
    return row


async def _row(db: Connection, actor: Actor, action_id: uuid.UUID) -> Row[Any]:
    stmt = queries.visible_actions(actor).where(action.c.id == action_id)
    row = (await db.execute(queries.action_rows(actor, stmt))).one_or_none()
    if row is None:
        raise NotFound(noun="action", ref=str(action_id))
    return row


async def _add_version(
    db: Connection, actor: Actor, action_id: uuid.UUID, number: int, definition: ActionDefinition
) -> None:
    values = {"id": uuid.uuid4(), "action_id": action_id, "number": number, "created_by_id": actor.person_id}
    await db.execute(insert(action_version).values(**values, **_stored(definition)))


def _stored(definition: ActionDefinition) -> dict[str, Any]:
    document = definition.model_dump(mode="json")
    written = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return {"definition": document, "definition_sha256": hashlib.sha256(written.encode()).digest()}


def _event(operation: str, made: ActionRead, *, by_power: bool = False) -> Event:
    project_id = made.project.id if made.project else None
    after: Metadata = {"version": made.latest.number}
    return Event(operation, "action", made.id, made.name, project_id, after=after, by_power=by_power)
