"""Operations on actions. Versions are immutable."""

import hashlib
import json
import uuid
from collections.abc import Mapping
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, RowMapping, Select, false, func, insert, literal, or_, select, update
from sqlalchemy.dialects.postgresql import insert as upsert
from sqlalchemy.exc import IntegrityError

from kleinkram.contract.access import Right
from kleinkram.contract.actions import (
    ActionDefinition,
    ActionFilter,
    ActionRead,
    ActionVersionRead,
    ClusterRequest,
)
from kleinkram.contract.base import Page
from kleinkram.contract.errors import FieldProblem, Forbidden, InvalidRequest, NameTaken, NotFound
from kleinkram.contract.locks import pinned_versions
from kleinkram.contract.metadata import Metadata
from kleinkram.contract.names import name_key
from kleinkram.contract.people import PersonRef
from kleinkram.contract.projects import ProjectRef
from kleinkram.server.access.actor import Actor, ActorKind
from kleinkram.server.access.rights import require_creator, require_match, require_project
from kleinkram.server.access.visible import visible_projects
from kleinkram.server.actions import dependency_locks
from kleinkram.server.audit.log import Event, audit
from kleinkram.server.context import AppContext
from kleinkram.server.db import Connection, matches_key, violated_constraint
from kleinkram.server.jobs.rejudge import judge_projects_again
from kleinkram.server.pagination import Order, PageRequest, read_page
from kleinkram.server.settings import Creators
from kleinkram.server.tables import action, action_version, person, project, project_action

_ACTION_ORDER = Order([action.c.name, action.c.id])
# Latest first.
_VERSION_ORDER = Order([action_version.c.number, action_version.c.id], descending=True)
_publisher = person.alias("publisher")
_ADDED = ("metadata", "checks", "reference")


async def list_actions(db: Connection, actor: Actor, *, matching: ActionFilter, page: PageRequest) -> Page[ActionRead]:
    """Return a page of the actions that match, by name.

    Raises:
        InvalidCursor: the cursor is not of this list.
    """
    stmt = _visible_actions(actor)
    if matching.name is not None:
        stmt = stmt.where(matches_key(action.c.name_key, matching.name))
    if matching.project_id is not None:
        stmt = stmt.where(or_(action.c.project_id.is_(None), action.c.project_id == matching.project_id))
    if matching.archived is not None:
        stmt = stmt.where(action.c.archived_at.is_not(None) if matching.archived else action.c.archived_at.is_(None))
    return await read_page(db, stmt, _ACTION_ORDER, page, lambda row: _to_action(_without_lock(row._mapping)))


async def get_action(db: Connection, actor: Actor, action_id: uuid.UUID) -> ActionRead:
    """Return one action.

    Raises:
        NotFound: it is not there, or not for this actor.
    """
    return _to_action(await _row(db, actor, action_id))


async def find_actions(db: Connection, actor: Actor, *, project_id: uuid.UUID | None) -> dict[str, ActionRead]:
    """Return the actions of a project, or of the whole lab, by the key of their name, without archived ones."""
    is_here = action.c.project_id.is_not_distinct_from(project_id)
    stmt = _visible_actions(actor).where(is_here, action.c.archived_at.is_(None))
    return {row["name_key"]: _to_action(row) for row in (await db.execute(stmt)).mappings()}


async def create_action(
    context: AppContext, actor: Actor, *, project_id: uuid.UUID | None, definition: ActionDefinition
) -> ActionRead:
    """Publish the first version of an action and return the action. Opens its own transactions.

    Raises:
        NotFound: the project is not there, or not for this actor.
        Forbidden: this actor may not publish there; for the whole lab, the settings reserve that to others.
        NameTaken: an action of this name exists.
        InvalidRequest: its dependencies cannot be locked.
    """
    creators = context.settings.creators
    if dependency_locks.needs_lock(definition, context.settings):
        async with context.database.begin() as db:
            await require_publisher(db, actor, project_id, creators)
        definition = await dependency_locks.lock(definition, context.settings)
    async with context.database.begin() as db:
        needs_admin = await require_publisher(db, actor, project_id, creators)
        return await _create_action(db, actor, project_id, definition, needs_admin=needs_admin)


async def require_publisher(db: Connection, actor: Actor, project_id: uuid.UUID | None, creators: Creators) -> bool:
    """Require the right to publish in a project, or for the whole lab; return whether that took admin rights.

    Raises:
        NotFound: the project is not there, or not for this actor.
        Forbidden: this actor may not publish there.
    """
    if project_id is None:
        return await require_creator(db, actor, creators, resource_type="action")
    await require_project(db, actor, "create_action", project_id)
    return False


async def _create_action(
    db: Connection, actor: Actor, project_id: uuid.UUID | None, definition: ActionDefinition, *, needs_admin: bool
) -> ActionRead:
    action_id, name = uuid.uuid4(), definition.name
    values = {"project_id": project_id, "name": name, "name_key": name_key(name)}
    try:
        await db.execute(insert(action).values(id=action_id, created_by_id=actor.person_id, **values))
    except IntegrityError as error:
        if violated_constraint(error) != "uq_action_name_key_live":
            raise
        raise NameTaken(resource_type="action", name=name) from error
    await _add_version(db, actor, action_id, 1, definition)
    made = await get_action(db, actor, action_id)
    await audit(db, actor, _event("action.create", made, needs_admin=needs_admin))
    return made


async def add_version(
    context: AppContext,
    actor: Actor,
    *,
    action_id: uuid.UUID,
    definition: ActionDefinition,
    if_match: str | None = None,
) -> ActionRead:
    """Publish a further version of an action and return the action. Opens its own transactions.

    It is unchanged where the definition equals the latest version, wherever that is from. Its lock stays, unless there
    is another one.

    Raises:
        NotFound: it is not there, or not for this actor.
        Forbidden: this actor may not change it.
        InvalidRequest: it has another name, or its dependencies cannot be locked.
        EditConflict: its ETag is no longer `if_match`: another person published a version, or archived it.
    """
    if dependency_locks.needs_lock(definition, context.settings):
        async with context.database.begin() as db:
            latest = (await _changeable(db, actor, action_id)).latest.definition
        if latest.lock is not None and is_same(definition, latest.model_copy(update={"lock": None})):
            definition = latest
        else:
            definition = await dependency_locks.lock(definition, context.settings)
    async with context.database.begin() as db:
        return await _add_next_version(db, actor, action_id, definition, if_match)


async def _add_next_version(
    db: Connection, actor: Actor, action_id: uuid.UUID, definition: ActionDefinition, if_match: str | None
) -> ActionRead:
    old = await _changeable(db, actor, action_id)
    if name_key(definition.name) != name_key(old.name):
        message = f"is {definition.name!r}, but this action is called {old.name!r}; publish it as another action"
        raise InvalidRequest(problems=[FieldProblem(field="definition.name", message=message)])
    if is_same(definition, old.latest.definition):
        return old
    require_match(if_match, old.etag, resource_type="action", name=old.name)
    await _add_version(db, actor, action_id, old.latest.number + 1, definition)
    made = await get_action(db, actor, action_id)
    await _judge_again(db, action_id)
    await audit(db, actor, _event("action.publish", made))
    return made


def is_same(one: ActionDefinition, other: ActionDefinition) -> bool:
    """Return whether two definitions run the same, whether or not they are from the library."""
    return one.model_copy(update={"library": None}) == other.model_copy(update={"library": None})


async def _judge_again(db: Connection, action_id: uuid.UUID) -> None:
    """Have the missions judged of the projects that name an action."""
    named_by = select(project_action.c.project_id).where(project_action.c.action_id == action_id)
    await judge_projects_again(db, (await db.execute(named_by)).scalars().all())


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
    require_match(if_match, old.etag, resource_type="action", name=old.name)
    values = {"archived_at": func.now() if archived else None}
    try:
        await db.execute(update(action).where(action.c.id == action_id).values(**values))
    except IntegrityError as error:
        raise NameTaken(resource_type="action", name=old.name) from error
    await _judge_again(db, action_id)
    made = await get_action(db, actor, action_id)
    await audit(db, actor, _event("action.archive" if archived else "action.restore", made))
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
    rows = _versions_of(action_id)
    return await read_page(db, rows, _VERSION_ORDER, page, lambda row: _to_version(_without_lock(row._mapping)))


async def get_version(db: Connection, actor: Actor, *, action_id: uuid.UUID, number: int) -> ActionVersionRead:
    """Return a version of an action, also of an archived one.

    Raises:
        NotFound: the action, or that version, is not there, or not for this actor.
    """
    row = await _row(db, actor, action_id)
    stmt = _versions_of(action_id).where(action_version.c.number == number)
    version = (await db.execute(stmt)).mappings().one_or_none()
    if version is None:
        raise NotFound(resource_type="version", ref=f"{row['name']}@{number}")
    return _to_version(version)


async def get_version_to_run(
    db: Connection, actor: Actor, *, action_id: uuid.UUID, number: int | None
) -> ActionVersionRead:
    """Return a version of an action that may be run; by default the latest.

    Raises:
        NotFound: the action, or that version, is not there, or not for this actor.
        InvalidRequest: it is archived.
    """
    row = await _row(db, actor, action_id)
    name = row["name"]
    if row["archived_at"] is not None:
        problem = FieldProblem(field="action_id", message=f"{name} is archived; restore it, or choose another")
        raise InvalidRequest(problems=[problem])
    if number is None:
        return _to_version(row)
    return await get_version(db, actor, action_id=action_id, number=number)


class UnpublishedVersion(NamedTuple):
    """A definition that was run without being published. `definition` has the lock that it was first run with."""

    id: uuid.UUID
    definition: ActionDefinition
    image_digest: str | None


async def find_unpublished(
    db: Connection, requested: ActionDefinition, *, is_to_lock: bool
) -> UnpublishedVersion | None:
    """Return the version of a definition that was run before; with `is_to_lock` only if the server locked it."""
    columns = action_version.c.id, action_version.c.definition, action_version.c.image_digest
    sha256 = definition_sha256(requested, is_to_lock=is_to_lock)
    same = (action_version.c.definition_sha256 == sha256) & action_version.c.action_id.is_(None)
    row = (await db.execute(select(*columns).where(same))).one_or_none()
    if row is None:
        return None
    return UnpublishedVersion(row.id, ActionDefinition.model_validate(row.definition), row.image_digest)


async def store_unpublished(
    db: Connection, actor: Actor, definition: ActionDefinition, *, is_locked_here: bool
) -> UnpublishedVersion:
    """Store a definition that is not published, once, and return it. `is_locked_here`: its lock is the server's.

    Then the lock does not make it another definition: the script runs with the first one until it is changed.
    """
    requested = definition.model_copy(update={"lock": None}) if is_locked_here else definition
    sha256 = definition_sha256(requested, is_to_lock=is_locked_here)
    values = {"definition": definition.model_dump(mode="json"), "definition_sha256": sha256}
    stmt = upsert(action_version).values(id=uuid.uuid4(), created_by_id=actor.person_id, **values)
    await db.execute(stmt.on_conflict_do_nothing())
    stored = await find_unpublished(db, requested, is_to_lock=is_locked_here)
    if stored is None:
        raise AssertionError("it was stored in this transaction")
    return stored


async def _changeable(db: Connection, actor: Actor, action_id: uuid.UUID) -> ActionRead:
    locked = select(action.c.id).where(action.c.id == action_id).with_for_update()
    await db.execute(locked)
    row = await get_action(db, actor, action_id)
    if not row.may_change:
        needs = "WRITE on its project" if row.project else "admin rights, or to be the person who created it"
        raise Forbidden(resource_type="action", operation="change the action", needs=needs)
    return row


async def _row(db: Connection, actor: Actor, action_id: uuid.UUID) -> RowMapping:
    stmt = _visible_actions(actor).where(action.c.id == action_id)
    row = (await db.execute(stmt)).mappings().one_or_none()
    if row is None:
        raise NotFound(resource_type="action", ref=str(action_id))
    return row


def _visible_actions(actor: Actor) -> Select[Any]:
    """Return the actions of projects that `actor` may read and, with an account, of the whole lab."""
    is_of_lab = action.c.project_id.is_(None)
    may_change_of_lab = is_of_lab & (literal(actor.is_admin) | (action.c.created_by_id == actor.person_id))
    sees_lab = actor.kind is ActorKind.person and actor.limits is None
    readable = visible_projects(actor).with_only_columns(project.c.id)
    writable = visible_projects(actor, Right.write).with_only_columns(project.c.id)
    newest = select(func.max(action_version.c.number)).where(action_version.c.action_id == action.c.id)
    return (
        select(
            action,
            *_version_columns(),
            project.c.name.label("project_name"),
            person.c.name.label("created_by_name"),
            or_(may_change_of_lab, action.c.project_id.in_(writable)).label("may_change"),
        )
        .outerjoin(project, project.c.id == action.c.project_id)
        .join(person, person.c.id == action.c.created_by_id)
        .join(action_version, action_version.c.action_id == action.c.id)
        .join(_publisher, _publisher.c.id == action_version.c.created_by_id)
        .where(or_(is_of_lab if sees_lab else false(), action.c.project_id.in_(readable)))
        .where(action_version.c.number == newest.correlate(action).scalar_subquery())
    )


def _versions_of(action_id: uuid.UUID) -> Select[Any]:
    stmt = select(*_version_columns()).join_from(
        action_version, _publisher, _publisher.c.id == action_version.c.created_by_id
    )
    return stmt.where(action_version.c.action_id == action_id)


def _version_columns() -> list[ColumnElement[Any]]:
    return [
        action_version.c.id.label("version_id"),
        action_version.c.number,
        action_version.c.definition,
        action_version.c.image_digest,
        action_version.c.created_at.label("version_created_at"),
        action_version.c.created_by_id.label("version_created_by_id"),
        _publisher.c.name.label("version_created_by_name"),
    ]


def _without_lock(row: Mapping[Any, Any]) -> dict[str, Any]:
    """Return a row of a list: of the lock, only the versions are in it."""
    definition = row["definition"]
    packages = pinned_versions(definition.get("lock"))
    return {**row, "definition": definition | {"lock": None}, "packages": packages}


def _to_version(row: Mapping[Any, Any]) -> ActionVersionRead:
    return ActionVersionRead(
        id=row["version_id"],
        number=row["number"],
        definition=ActionDefinition.model_validate(row["definition"]),
        packages=row.get("packages") or pinned_versions(row["definition"].get("lock")),
        image_digest=row["image_digest"],
        created_at=row["version_created_at"],
        created_by=PersonRef(id=row["version_created_by_id"], name=row["version_created_by_name"]),
    )


def _to_action(row: Mapping[Any, Any]) -> ActionRead:
    latest = _to_version(row)
    has_project = row["project_id"] is not None
    return ActionRead(
        id=row["id"],
        name=row["name"],
        description=latest.definition.description,
        project=ProjectRef(id=row["project_id"], name=row["project_name"]) if has_project else None,
        latest=latest,
        archived=row["archived_at"] is not None,
        created_at=row["created_at"],
        created_by=PersonRef(id=row["created_by_id"], name=row["created_by_name"]),
        may_change=row["may_change"],
    )


async def _add_version(
    db: Connection, actor: Actor, action_id: uuid.UUID, number: int, definition: ActionDefinition
) -> None:
    values = {"id": uuid.uuid4(), "action_id": action_id, "number": number, "created_by_id": actor.person_id}
    await db.execute(insert(action_version).values(**values, **_stored(definition)))


def _stored(definition: ActionDefinition) -> dict[str, Any]:
    sha256 = definition_sha256(definition, is_to_lock=False)
    return {"definition": definition.model_dump(mode="json"), "definition_sha256": sha256}


def definition_sha256(definition: ActionDefinition, *, is_to_lock: bool) -> bytes:
    """Return the hash by which a definition that is not published is found. `is_to_lock`: the server makes its lock."""
    document = definition.model_dump(mode="json", exclude={"library"})
    if is_to_lock:
        document["lock"] = "the server's"
    # A definition that does not use them has the hash that it had before these fields existed.
    document["inputs"] = {name: value for name, value in document["inputs"].items() if value or name not in _ADDED}
    if definition.cluster == ClusterRequest():
        del document["cluster"]
    written = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(written.encode()).digest()


def _event(operation: str, made: ActionRead, *, needs_admin: bool = False) -> Event:
    project_id = made.project.id if made.project else None
    after: Metadata = {"version": made.latest.number}
    return Event(operation, "action", made.id, made.name, project_id, after=after, needs_admin=needs_admin)
